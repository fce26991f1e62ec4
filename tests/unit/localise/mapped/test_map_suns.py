"""Suns over the map's picture, tile by tile."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.unit.localise.mapped.test_light import EVENING, MORNING, photograph, wood
from visloc_companion.localise.local_frame import local_frame
from visloc_companion.localise.mapped import map_suns
from visloc_companion.localise.mapped.map_suns import TILE_M, MapSuns
from visloc_companion.types import GeoPoint

HOME = GeoPoint(47.0, 8.0, 0.0)


@pytest.fixture(scope="module")
def mosaic(support):
    """A wood that was photographed in the morning in the west, in the evening in the east."""
    up = wood(7, 700)
    pixels = photograph(up, MORNING)
    pixels[:, 350:] = photograph(up, EVENING)[:, 350:]
    return support.FlatMap(np.asarray(pixels, dtype=np.uint8), up)


def azimuth_deg(suns, mosaic, place, east_m):
    sun = suns.over(mosaic, local_frame(place, mosaic), np.array([0.0, east_m]))
    assert sun is not None
    return sun.azimuth_deg


def test_each_picture_of_a_mosaic_has_its_sun(mosaic):
    suns = MapSuns()
    assert azimuth_deg(suns, mosaic, HOME, -200.0) == pytest.approx(MORNING.azimuth_deg, abs=15)
    assert azimuth_deg(suns, mosaic, HOME, 200.0) == pytest.approx(EVENING.azimuth_deg, abs=15)


def test_a_tile_is_looked_at_once_and_from_anywhere_alike(mosaic, monkeypatch):
    looked = []
    found = map_suns.sun_over
    monkeypatch.setattr(map_suns, "sun_over", lambda *what: looked.append(1) or found(*what))
    suns = MapSuns()
    middle = (math.floor(-200.0 / TILE_M) + 0.5) * TILE_M
    beside = GeoPoint(47.0, 8.0 + 30.0 / (111_320 * math.cos(math.radians(47.0))), 0.0)
    first = azimuth_deg(suns, mosaic, HOME, middle)
    assert azimuth_deg(suns, mosaic, HOME, middle + 0.3 * TILE_M) == first
    assert azimuth_deg(suns, mosaic, beside, middle - 30.0) == first
    assert len(looked) == 1
    assert azimuth_deg(MapSuns(), mosaic, beside, middle - 30.0) == pytest.approx(first, abs=0.5)


def test_another_map_has_suns_of_its_own(mosaic, support):
    suns, up = MapSuns(), wood(7, 700)
    assert azimuth_deg(suns, mosaic, HOME, -200.0) == pytest.approx(MORNING.azimuth_deg, abs=15)
    other = support.FlatMap(np.asarray(photograph(up, EVENING), dtype=np.uint8), up)
    assert azimuth_deg(suns, other, HOME, -200.0) == pytest.approx(EVENING.azimuth_deg, abs=15)


def test_level_ground_has_none(support):
    flat = support.FlatMap(support.texture(1, 500), np.full((500, 500), 100.0, np.float32))
    assert MapSuns().over(flat, local_frame(HOME, flat), np.zeros(2)) is None


def test_where_there_is_no_map_there_is_no_sun(mosaic, support):
    known = np.ones(mosaic.pixels.shape, np.bool_)
    known[150:, 200:] = False
    gap = support.FlatMap(mosaic.pixels, mosaic.surface, known=known)
    assert MapSuns().over(gap, local_frame(HOME, gap), np.array([-64.0, 64.0])) is None
