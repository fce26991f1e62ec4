"""Holes of surface models."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from visloc_companion.evaluate.images.case_map import open_case_map
from visloc_companion.maps import filled

PLACE = (47.0, 9.0)


def holed(share: float, side: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """(side, side) heights of a slope, -9999 where there is none, and where there is one: lone holes, and a large one."""
    rows, cols = np.mgrid[:side, :side]
    known = np.random.default_rng(1).random((side, side)) >= share
    known[80:120, 80:120] = False
    return np.where(known, 400.0 + 0.3 * cols + 0.1 * rows, -9999.0).astype(np.float32), known


@pytest.mark.parametrize("strip_rows", [7, 64, 200, 1000])
def test_strips_fill_as_the_whole_is_filled(monkeypatch: pytest.MonkeyPatch, strip_rows: int) -> None:
    monkeypatch.setattr(filled, "STRIP_ROWS", strip_rows)
    heights_m, known = holed(0.3)
    want = filled.filled(heights_m, known, 5)
    filled.fill_holes(heights_m, known, 5)
    np.testing.assert_array_equal(known, np.isfinite(want))
    np.testing.assert_allclose(heights_m[known], want[known], atol=1e-3)
    assert not known[90:110, 90:110].any(), "a large hole stays one"


def test_nothing_is_made_of_nothing() -> None:
    heights_m, known = np.zeros((20, 20), np.float32), np.zeros((20, 20), np.bool_)
    filled.fill_holes(heights_m, known, 12)
    assert not known.any()


def test_how_far_holes_are_filled_from() -> None:
    assert [filled.fill_reach_px(pixel_m) for pixel_m in (0.5, 2.5, 5.0, 30.0, 90.0)] == [12, 12, 6, 1, 1]


@pytest.mark.parametrize("crs", ["EPSG:32632", "EPSG:4326"])
def test_scattered_holes_of_a_surface_model_cost_no_map(tmp_path: Path, write_raster, crs: str) -> None:
    """With 5 % of its pixels missing a window of the map was half empty, and no frame was placed there."""
    heights_m, _ = holed(0.05)
    write_raster(
        tmp_path / "a.tif", np.random.default_rng(1).integers(1, 255, (200, 200), dtype=np.uint8), "EPSG:32632", PLACE, 1.0
    )
    T = write_raster(tmp_path / "dsm.tif", heights_m, crs, PLACE, 1.0, nodata=-9999)
    reference = open_case_map(tmp_path / "a.tif", tmp_path / "dsm.tif")
    patch = reference.patch(reference.center_map_m, (120, 120), 1.0, 0.4)
    large = np.zeros((120, 120), np.bool_)
    large[30:90, 30:90] = True
    assert patch.valid[~large].all() and 0.015 < 1 - patch.valid.mean() < 0.05
    if crs == "EPSG:32632":
        place = T @ [150.0, 40.0, 1.0]
        assert reference.height_amsl_m(*place) == pytest.approx(400.0 + 45.0 + 4.0, abs=0.3)
