"""Reference maps, read-only: packs and rasters."""
