"""Geometry, pure: transforms, WGS 84, camera, rasters' half pixel, rays."""
