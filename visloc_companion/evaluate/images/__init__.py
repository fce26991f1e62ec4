"""Folders of image cases: run, measured, broken down and reported."""
