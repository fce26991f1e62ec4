"""Rasters of a build that do not fit in memory together: they lie on the disk, and the pack is the same."""

from __future__ import annotations

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

from tests.unit.prepare.test_build import PLACE, UTM, picture, slope
from visloc_companion.errors import MapError
from visloc_companion.maps import spilled
from visloc_companion.maps.geotiff import layer_of, open_ortho
from visloc_companion.maps.layer import array_layer
from visloc_companion.maps.spilled import Spill, SpilledLayer
from visloc_companion.prepare import build
from visloc_companion.prepare.build import build_pack

SIDE, TILES = 300, 5


@pytest.fixture
def tiles(tmp_path: Path, write_raster) -> tuple[list[Path], list[Path]]:
    """Orthophotos in colour, with a hole in each, and surface models, side by side."""
    orthos, dsms = [], []
    for k in range(TILES):
        place = (PLACE[0], PLACE[1] + k * 3.9e-3)
        rgb = np.dstack([picture(SIDE, k + band) for band in range(3)])
        rgb[40:90, 50:100] = 0
        orthos.append(tmp_path / f"a{k}.tif")
        write_raster(orthos[-1], rgb, UTM, place, 1.0, photometric="RGB", nodata=0)
        dsms.append(tmp_path / f"d{k}.tif")
        write_raster(dsms[-1], slope(SIDE), UTM, place, 1.0)
    return orthos, dsms


def test_the_pack_is_the_same(tmp_path: Path, tiles, monkeypatch: pytest.MonkeyPatch) -> None:
    orthos, dsms = tiles
    in_memory = build_pack(orthos, dsms, tmp_path / "pack").files
    monkeypatch.setattr(spilled, "MOST_HELD_BYTES", 1_000_000)
    kinds: list[str] = []

    def write_ortho(path: Path, grid: Any, sources: Any, step: Any) -> float:
        kinds.extend(type(source.layer).__name__ for source in sources)
        return build_ortho(path, grid, sources, step)

    build_ortho = build.write_ortho
    monkeypatch.setattr(build, "write_ortho", write_ortho)
    assert build_pack(orthos, dsms, tmp_path / "pack").files == in_memory
    assert kinds == ["ArrayLayer"] * 2 + ["SpilledLayer"] * 3
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*(p.name for p in (*orthos, *dsms)), "pack"])


def test_memory_does_not_grow_with_the_number_of_rasters(tmp_path: Path, tiles, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spilled, "MOST_HELD_BYTES", 1_000_000)
    one = SIDE * SIDE * 4
    tracemalloc.start()
    spill = Spill(tmp_path)
    kept = [spill.kept(layer_of(open_ortho(path))) for path in tiles[0]]
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert held < 1_000_000 + one, f"{TILES} of {one} bytes and their levels"
    whole = layer_of(open_ortho(tiles[0][-1]))
    assert isinstance(kept[-1], SpilledLayer) and kept[-1].shapes == whole.shapes
    for level, (rows, cols) in enumerate(whole.shapes):
        window = level, (3, rows), (5, cols - 1)
        for got, want in zip(kept[-1].read(*window), whole.read(*window), strict=True):
            np.testing.assert_array_equal(got, want)


def test_a_disk_that_refuses_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spilled, "MOST_HELD_BYTES", 0)
    layer = array_layer(np.eye(2, 3), np.zeros((64, 64), np.float32), np.ones((64, 64), np.bool_))
    with pytest.raises(MapError, match=r"gone: 0\.0 MB .* cannot be written: No such file or directory; remedy: check"):
        Spill(tmp_path / "gone").kept(layer)


def test_sixteen_bits_are_stretched_a_strip_at_a_time(tmp_path: Path, write_raster) -> None:
    """What is reckoned with in between took 29 times the picture's bytes: 11 GB of one of 400 MB."""
    side = 1200
    values = np.dstack([picture(side, band).astype(np.uint16) * 16 for band in range(3)])
    write_raster(tmp_path / "a.tif", values, UTM, PLACE, 1.0, photometric="RGB")
    tiff = open_ortho(tmp_path / "a.tif")
    tracemalloc.start()
    layer_of(tiff)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 9 * values.size
    with rasterio.open(tmp_path / "a.tif") as stored:
        assert stored.dtypes[0] == "uint16"
