"""A small world for the tests of the shell: an orthophoto of blobs and edges, and its pack."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from affine import Affine

from visloc_companion.prepare.build import build_pack


@dataclass(frozen=True)
class SmallWorld:
    """300 x 300 m of flat ground at height 0; easting and northing of the north-west corner in EPSG:32632."""

    ortho: Path
    pack: Path
    east_m: float = 500_000.0
    north_m: float = 5_205_000.0
    gsd_m: float = 0.5


@pytest.fixture(scope="session")
def small_world(tmp_path_factory: pytest.TempPathFactory) -> SmallWorld:
    """Built once."""
    folder = tmp_path_factory.mktemp("small_world")
    world, size_px, rng = SmallWorld(folder / "ortho.tif", folder / "pack"), 600, np.random.default_rng(8)
    grey = cv2.GaussianBlur(rng.normal(size=(size_px, size_px)), (0, 0), 3) * 900 + 128
    for _ in range(60):
        (u, v), side = rng.integers(0, size_px, 2), int(rng.integers(8, 40))
        grey[v : v + side, u : u + side] = rng.uniform(30, 220)
    pixels = np.clip(grey, 0, 255).astype(np.uint8)
    transform = Affine(world.gsd_m, 0, world.east_m, 0, -world.gsd_m, world.north_m)
    profile = {"driver": "GTiff", "width": size_px, "height": size_px, "count": 3, "dtype": "uint8", "crs": "EPSG:32632"}
    with rasterio.open(world.ortho, "w", transform=transform, **profile) as file:
        file.write(np.stack([pixels] * 3))
    build_pack([world.ortho], None, world.pack, ground_h_amsl_m=0.0, capture_date="2026-01-01")
    return world
