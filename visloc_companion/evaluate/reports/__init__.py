"""Pieces of reports: style, charts, maps, the Stanford diagram."""
