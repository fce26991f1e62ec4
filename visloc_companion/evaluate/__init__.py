"""Judging: cases, metrics, reports."""
