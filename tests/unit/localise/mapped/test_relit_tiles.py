"""The map as under another sun, tile by tile."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
import rasterio

from tests.unit.localise.mapped.test_light import EVENING, MORNING, photograph, wood
from visloc_companion.errors import OutsideMap
from visloc_companion.geo.raster import apply_affine, invert_affine
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.features.grey import GREY
from visloc_companion.localise.local_frame import local_frame
from visloc_companion.localise.mapped import relit_tiles
from visloc_companion.localise.mapped.light import Light, relit
from visloc_companion.localise.mapped.relit_tiles import SIDE_PX, RelitTiles, serves
from visloc_companion.maps.raster import RasterMap
from visloc_companion.types import GeoPoint

HOME = GeoPoint(47.0, 8.0, 0.0)
LIGHT = Light(MORNING, EVENING)
SIZE = (180, 140)


class Counted:
    """A map that counts how often it is read."""

    def __init__(self, inner) -> None:
        self.inner, self.read = inner, 0

    def __getattr__(self, name):
        return getattr(self.inner, name)

    def patch(self, *what):
        self.read += 1
        return self.inner.patch(*what)


@pytest.fixture(scope="module")
def wooded(support):
    up = wood(3, 701)
    return support.FlatMap(np.asarray(photograph(up, MORNING), dtype=np.uint8), up)


@pytest.fixture
def forest(wooded):
    return Counted(wooded)


def window(tiles, ref, centre, size=SIZE, gsd_m=1.0, light=LIGHT):
    return tiles.patch(ref, local_frame(HOME, ref), centre, size, gsd_m, GRADIENT, light)


def test_a_window_shows_the_map_as_under_the_other_sun(forest):
    patch = window(RelitTiles(), forest, (0.0, 0.0))  # over the corner of four tiles
    assert patch.gsd_m == pytest.approx(1.0, rel=0.01) and patch.valid.all()
    whole = relit(forest.pixels.astype(np.float32), forest.surface, 1.0, LIGHT)
    expected = GRADIENT(whole, np.ones(whole.shape, np.bool_))
    v, u = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]
    at = apply_affine(patch.T_map_pix, np.stack([u, v], -1).astype(float))
    col, row = np.rint(at[..., 0] + 350).astype(int), np.rint(350 - at[..., 1]).astype(int)
    assert float(np.corrcoef(patch.features.ravel(), expected[row, col].ravel())[0, 1]) > 0.98
    unlit = GRADIENT(forest.pixels, np.ones(whole.shape, np.bool_))
    assert float(np.corrcoef(patch.features.ravel(), unlit[row, col].ravel())[0, 1]) < 0.5
    assert np.abs(patch.dsm_amsl_m - forest.surface[row, col]).mean() < 0.01


def test_a_tile_is_made_once_and_from_anywhere_alike(forest):
    tiles = RelitTiles()
    first = window(tiles, forest, (0.0, 0.0))
    assert forest.read == 4
    second = window(tiles, forest, (7.2, -5.1))
    assert forest.read == 4
    right, up = np.rint(second.T_map_pix[:, 2] - first.T_map_pix[:, 2]).astype(int).tolist()
    assert (right, up) == (pytest.approx(7, abs=1), pytest.approx(-5, abs=1))
    assert np.array_equal(second.features[:up, :-right], first.features[-up:, right:])
    alone = window(RelitTiles(), forest, (7.2, -5.1))
    assert np.array_equal(alone.features, second.features)


def test_another_light_resolution_or_map_has_tiles_of_its_own(forest, support):
    tiles = RelitTiles()
    first = window(tiles, forest, (100.0, 100.0))
    assert forest.read == 1
    other = window(tiles, forest, (100.0, 100.0), light=Light(EVENING, MORNING))
    assert forest.read == 2 and not np.array_equal(other.features, first.features)
    assert window(tiles, forest, (100.0, 100.0), gsd_m=1.4).gsd_m == pytest.approx(1.4, rel=0.01)
    read = forest.read
    another = Counted(support.FlatMap(np.asarray(photograph(wood(4, 700), MORNING), dtype=np.uint8), wood(4, 700)))
    assert not np.array_equal(window(tiles, another, (100.0, 100.0)).features, first.features)
    assert another.read == 1 and forest.read == read


def test_only_the_latest_tiles_are_kept(forest, monkeypatch):
    monkeypatch.setattr(relit_tiles, "MOST", 2)
    tiles = RelitTiles()
    places = [(100.0, 100.0), (-150.0, 100.0), (100.0, -150.0)]
    for place in places:
        window(tiles, forest, place)
    read = forest.read
    window(tiles, forest, places[0])
    assert forest.read == read + 1
    window(tiles, forest, places[0])
    assert forest.read == read + 1


def test_where_the_map_ends_the_window_is_not_valid_and_beyond_it_is_outside(forest):
    patch = window(RelitTiles(), forest, (340.0, 0.0))
    east = apply_affine(patch.T_map_pix, np.array([[float(u), 70.0] for u in range(SIZE[0])]))[:, 0]
    inside = east < 349.0
    assert patch.valid[70][inside].all() and not patch.valid[70][east > 351.0].any()
    assert not patch.features[:, east > 351.0].any()
    with pytest.raises(OutsideMap, match="outside the map"):
        window(RelitTiles(), forest, (5.0 * SIDE_PX, 0.0))


def test_a_kept_tile_keeps_nothing_of_its_margin(forest):
    """Views of what was read for shadows kept 4 MB a tile at 0.1 m a pixel, 64 tiles of them."""
    tiles = RelitTiles()
    window(tiles, forest, (100.0, 100.0))
    (tile,) = tiles._kept.values()
    assert tile is not None
    assert tile.valid.shape == tile.dsm_amsl_m.shape == tile.features.shape[:2] == (SIDE_PX, SIDE_PX)
    for values in (tile.features, tile.valid, tile.dsm_amsl_m):
        whole = values if values.base is None else values.base
        assert whole.nbytes == values.nbytes


def raster_map(folder, pixels, crs, west, north, pixel):
    path = folder / "ortho.tif"
    transform = rasterio.Affine(pixel[0], 0.0, west, 0.0, -pixel[1], north)
    shape = {"height": pixels.shape[0], "width": pixels.shape[1], "count": 1}
    with rasterio.open(path, "w", "GTiff", **shape, dtype="uint8", crs=crs, transform=transform) as file:
        file.write(pixels, 1)
    return RasterMap.open(path, None, 100.0)


def test_tiles_lie_where_they_say_over_a_map_whose_scale_is_another_to_the_north_than_to_the_east(tmp_path, support):
    """In Portugal EPSG:3035 stretches by 1.4 % one way and shrinks the other: tiles lay up to 3.5 m beside their place."""
    pixels = support.texture(2, 900)
    ref = raster_map(tmp_path, pixels, "EPSG:3035", 2_700_000.0, 1_950_000.0, (1.0, 1.0))
    centre = 2_700_450.0, 1_949_550.0
    frame = local_frame(GeoPoint(*ref.to_geo(*centre), 0.0), ref)
    assert serves(frame)
    patch = RelitTiles().patch(ref, frame, centre, (360, 360), 1.0, GREY, Light(MORNING, MORNING))
    assert patch.valid.all()
    v, u = np.mgrid[0:360, 0:360]
    pix = apply_affine(invert_affine(ref.T_map_pix), apply_affine(patch.T_map_pix, np.stack([u, v], -1).astype(float)))
    there = cv2.remap(pixels, *(np.float32(pix[..., k]) for k in (0, 1)), cv2.INTER_LINEAR)
    for block in (np.s_[r : r + 60, c : c + 60] for r in range(0, 360, 60) for c in range(0, 360, 60)):
        assert float(np.corrcoef(patch.features[block].ravel(), there[block].ravel())[0, 1]) > 0.95


def test_degrees_serve_for_no_tiles(tmp_path, support):
    lat_deg, step = 47.0, 1 / 111_200
    pixel = step / math.cos(math.radians(lat_deg)), step
    ref = raster_map(tmp_path, support.texture(2, 300), "EPSG:4326", 8.0, lat_deg, pixel)
    assert not serves(local_frame(GeoPoint(lat_deg - 150 * step, 8.0 + 150 * pixel[0], 0.0), ref))
