"""Orthophotos whose values count from white."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from numpy.typing import NDArray

from visloc_companion.maps.geotiff import layer_of, open_ortho

RNG = np.random.default_rng(4)
GREY = RNG.integers(1, 255, (60, 80)).astype(np.uint8)


def saved(path: Path, values: NDArray[np.generic], **profile: object) -> Path:
    rows, cols = values.shape
    place = {"crs": "EPSG:32632", "transform": Affine(0.5, 0, 500_000, 0, -0.5, 5_205_000)}
    with rasterio.open(
        path, "w", driver="GTiff", width=cols, height=rows, count=1, dtype=values.dtype, **place, **profile
    ) as file:
        file.write(values, 1)
    return path


@pytest.mark.parametrize("in_memory_bytes", [0, 10**9])
def test_a_negative_is_read_as_what_it_shows(tmp_path: Path, in_memory_bytes: int) -> None:
    path = saved(tmp_path / "a.tif", 255 - GREY, photometric="MINISWHITE")
    values, valid = layer_of(open_ortho(path), in_memory_bytes).read(0, (0, 60), (0, 80))
    assert valid.all()
    np.testing.assert_array_equal(values, GREY)


def test_of_16_bits_too(tmp_path: Path) -> None:
    """As the same picture that counts from black, to one of 255 shades."""
    deep = GREY.astype(np.uint16) * 200
    black = layer_of(open_ortho(saved(tmp_path / "black.tif", deep))).read(0, (0, 60), (0, 80))
    white = layer_of(open_ortho(saved(tmp_path / "white.tif", 65535 - deep, photometric="MINISWHITE"))).read(0, (0, 60), (0, 80))
    assert np.abs(black[0].astype(int) - white[0]).max() <= 1
    np.testing.assert_array_equal(black[1], white[1])


def test_what_it_does_not_show_stays_empty(tmp_path: Path) -> None:
    negative = 255 - GREY
    negative[:10] = 0
    path = saved(tmp_path / "a.tif", negative, photometric="MINISWHITE", nodata=0)
    values, valid = layer_of(open_ortho(path)).read(0, (0, 60), (0, 80))
    assert not values[:10].any()
    np.testing.assert_array_equal(valid > 0, negative > 0)


def test_the_coarser_levels_of_a_large_one(tmp_path: Path) -> None:
    black = layer_of(open_ortho(saved(tmp_path / "black.tif", GREY)), 0).read(1, (0, 30), (0, 40))
    white = layer_of(open_ortho(saved(tmp_path / "white.tif", 255 - GREY, photometric="MINISWHITE")), 0).read(1, (0, 30), (0, 40))
    assert np.abs(black[0].astype(int) - white[0]).max() <= 1
