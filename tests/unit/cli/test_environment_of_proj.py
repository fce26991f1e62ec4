"""What the environment says to PROJ is meant for other programs."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio import Affine

RUN = (sys.executable, "-m", "visloc_companion.cli.main")


def visloc(*arguments: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*RUN, *map(str, arguments)], env=os.environ | environment, capture_output=True, text=True, check=False)


@pytest.fixture
def ortho(tmp_path: Path) -> Path:
    """A map in feet (NAD83, North Dakota), whose place and unit only PROJ's database tells."""
    path = tmp_path / "ortho.tif"
    pixels = np.random.default_rng(1).integers(20, 230, (3, 300, 300), dtype=np.uint8)
    place = Affine(16.0, 0.0, 2296000.0, 0.0, -16.0, 14500.0)
    with rasterio.open(
        path, "w", driver="GTiff", dtype="uint8", count=3, height=300, width=300, crs="EPSG:2265", transform=place
    ) as file:
        file.write(pixels)
    return path


@pytest.mark.parametrize("name", ["PROJ_DATA", "PROJ_LIB"])
def test_the_database_of_another_program_is_not_asked(ortho: Path, tmp_path: Path, name: str) -> None:
    """With conda's or QGIS's in PROJ_LIB each orthophoto was in a CRS that is "neither projected nor geographic"."""
    other = tmp_path / "other"
    other.mkdir()
    (other / "proj.db").write_bytes(b"of another version")
    done = visloc("map", "build", "--ortho", ortho, "--out", tmp_path / "pack", "--model", "none", **{name: str(other)})
    assert done.returncode == 0, done.stderr


def test_no_grid_is_fetched_and_the_map_is_where_it_is_without_a_network(ortho: Path, tmp_path: Path) -> None:
    """With PROJ_NETWORK=ON, and nobody to answer, the map's middle was no place in its CRS, and the daemon did not start."""
    asked = {"PROJ_NETWORK": "ON", "PROJ_NETWORK_ENDPOINT": "http://127.0.0.1:9"}
    done = visloc("map", "build", "--ortho", ortho, "--out", tmp_path / "pack", "--model", "none", **asked)
    assert done.returncode == 0, done.stderr
    there = visloc("map", "info", tmp_path / "pack", **asked)
    assert there.returncode == 0 and there.stdout == visloc("map", "info", tmp_path / "pack").stdout
