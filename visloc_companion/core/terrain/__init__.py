"""Soundings: distances to the ground along the track."""
