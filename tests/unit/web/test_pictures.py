"""Tiles of a pack: each pixel lies where the description says, and what is outside is transparent."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from visloc_companion.errors import MapError, OutsideMap
from visloc_companion.maps.crs import map_crs
from visloc_companion.prepare.build import build_pack
from visloc_companion.web import pictures as module
from visloc_companion.web.pictures import LATTICE, TILE_PX, MapPictures

ROWS, COLS, CRS = 900, 1300, "EPSG:32632"


@pytest.fixture(scope="module")
def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("pictures")


@pytest.fixture
def pack(shared_folder: Path, write_raster: Callable[..., Any]) -> Path:
    """Red grows eastwards and green southwards, so that a pixel tells where it lies."""
    folder = shared_folder / "gradient"
    if not folder.exists():
        v, u = np.mgrid[0:ROWS, 0:COLS]
        pixels = np.dstack([20 + 200 * u / COLS, 20 + 200 * v / ROWS, np.full(u.shape, 90)]).astype(np.uint8)
        write_raster(shared_folder / "o.tif", pixels, CRS, (47.4, 8.55), 0.5)
        write_raster(shared_folder / "d.tif", np.full((ROWS, COLS), 400.0, np.float32), CRS, (47.4, 8.55), 0.5)
        build_pack([shared_folder / "o.tif"], shared_folder / "d.tif", folder)
    return folder


def decoded(data: bytes) -> np.ndarray:
    found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert found is not None
    return found if found.shape[2] == 4 else np.dstack([found, np.full(found.shape[:2], 255, np.uint8)])  # opaque


def test_every_level_shows_the_same_ground_at_the_same_place(pack: Path) -> None:
    pictures = MapPictures(pack)
    assert pictures.levels == 3
    for level, (col, row), (x, y) in [
        (0, (0, 0), (200, 100)),
        (1, (1, 0), (60, 300)),
        (2, (2, 1), (40, 200)),
        (2, (0, 0), (5, 5)),
    ]:
        step = 2 ** (2 - level)
        u, v = (col * TILE_PX + x + 0.5) * step, (row * TILE_PX + y + 0.5) * step
        b, g, r, a = decoded(pictures.tile(level, col, row))[y, x].tolist()
        assert a == 255
        assert (r, g, b) == pytest.approx((20 + 200 * u / COLS, 20 + 200 * v / ROWS, 90), abs=5)


def test_outside_the_map_is_transparent_and_there_are_no_tiles_beyond_it(pack: Path) -> None:
    pictures = MapPictures(pack)
    overview = decoded(pictures.tile(0, 0, 0))
    assert overview.shape == (TILE_PX, TILE_PX, 4)
    assert overview[ROWS // 4 + 4 :, :, 3].max() == 0
    assert overview[: ROWS // 4 - 2, : COLS // 4 - 2, 3].min() == 255
    for tile in ((0, 1, 0), (2, 3, 0), (3, 0, 0), (-1, 0, 0), (2, -1, 0), (2, 0, 10**9)):
        with pytest.raises(OutsideMap):
            pictures.tile(*tile)


def test_the_lattice_states_the_rasters_outer_corners(pack: Path) -> None:
    description = MapPictures(pack).description()
    assert (description["rows"], description["cols"], description["gsd_m"]) == (ROWS, COLS, pytest.approx(0.5, rel=1e-3))
    assert len(description["places"]) == LATTICE**2
    here = map_crs(CRS)
    north_west, north_east, south_west = (
        here.to_map(*description["places"][k]) for k in (0, LATTICE - 1, LATTICE * (LATTICE - 1))
    )
    middle = here.to_map(*description["places"][LATTICE**2 // 2])
    assert middle == pytest.approx(here.to_map(47.4, 8.55), abs=0.01)
    scale = (north_east[0] - north_west[0]) / COLS
    assert scale == pytest.approx(0.5, rel=1e-3)
    assert north_west[1] - south_west[1] == pytest.approx(scale * ROWS, rel=1e-4)


def test_kept_tiles_are_bounded(pack: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "KEPT", 2)
    pictures = MapPictures(pack)
    first = pictures.tile(2, 0, 0)
    for col in range(3):
        pictures.tile(2, col, 1)
    assert len(pictures._kept) == 2
    assert pictures.tile(2, 0, 0) == first


def test_what_is_no_pack_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(MapError):
        MapPictures(tmp_path)
