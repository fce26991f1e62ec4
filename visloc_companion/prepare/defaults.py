"""Defaults that the commands show: nothing heavy is imported for them."""

FINEST_FEATURES_M = 0.4
"""Features of networks are stored from about this GSD on: what a camera of 60 degrees works with from 80 m above ground."""
DEFAULT_BOARD = "charuco:11x8:22mm:16mm"
"""Fits an A4 sheet with rulers; it may leave the picture, so that corners are seen to its very rim."""
