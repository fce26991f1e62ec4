"""Terrain-referenced navigation: heights measured below the vehicle against an elevation model (docs/terrain.md)."""
