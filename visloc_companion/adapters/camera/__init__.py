"""Cameras: files, video devices, network streams."""
