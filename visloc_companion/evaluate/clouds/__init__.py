"""Folders of cloud cases: run, measured and reported."""
