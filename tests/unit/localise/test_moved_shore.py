"""A frame beside water whose level has changed since the map was made is not placed by the shore."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.localise.dense import gradient_localiser
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.iclk import IclkLocaliser
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.types import CameraModel, Fix, NoFix

MODEL = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)
TRUTH, LEVEL = (5.0, -4.0, -240.0), (0.0, 0.0, 0.6)
SIZE = 500


def lake(support, of_land, of_water, risen_m=0.0, contrast=0.15):
    """Faint land to the west of a winding shore, water to the east of it, on level ground of 1 m pixels."""
    u, v = np.meshgrid(np.arange(SIZE) - SIZE / 2, np.arange(SIZE) - SIZE / 2)
    beyond_m = u + risen_m - 10 * np.sin(v / 35) - 4 * np.sin(v / 11 + 1)
    land = 150 + contrast * (support.texture(of_land, SIZE).astype(np.float32) - 130)
    waves = np.random.default_rng(of_water).standard_normal((SIZE, SIZE)).astype(np.float32)
    pixels = np.where(beyond_m > 0, 45 + 8 * cv2.GaussianBlur(waves, (0, 0), 1.5), land)
    return support.FlatMap(np.clip(pixels, 0, 255).astype(np.uint8), np.full((SIZE, SIZE), 100.0, np.float32))


def answer(support, of_map, as_seen):
    request = support.request_at((2.0, 0.0, -238.0), (0.0, 0.0, 0.62), sigma_m=8.0)
    frame = support.render(as_seen, MODEL, TRUTH, LEVEL)
    return gradient_localiser(MODEL, LocaliserSettings()).localise(request, frame, of_map)


@pytest.mark.parametrize(("of_land", "seed"), [(0, 0), (50, 0), (2, 2), (52, 2)], ids=["same", "changed", "same 2", "changed 2"])
def test_a_shore_that_has_moved_places_no_frame(support, of_land, seed):
    """By the shore the fix was 9.7 to 10 m off, claimed 1.6 to 2 m and to be wrong with 0.0001 to 0.0005. The land is as on the
    map, or another."""
    told = answer(support, lake(support, seed, 100), lake(support, of_land, 200 + seed, risen_m=10.0))
    assert isinstance(told, NoFix), told
    assert told.reason is Reason.BLOCKS_DISAGREE
    assert dict(told.evidence)["p_wrong"] > 0.05


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_half_a_frame_of_land_that_is_as_on_the_map_does(support, seed):
    told = answer(support, lake(support, seed, 100), lake(support, seed, 200 + seed))
    assert isinstance(told, Fix), told
    north, east, _ = ned_from_geo(told.place, support.HOME)
    assert np.hypot(north - TRUTH[0], east - TRUTH[1]) < 1.0
    assert dict(told.evidence)["votes"] > 0.99


def test_clear_land_outweighs_a_shore_that_has_moved(support):
    told = answer(support, lake(support, 1, 100, contrast=0.5), lake(support, 1, 201, risen_m=10.0, contrast=0.5))
    assert isinstance(told, Fix), told
    north, east, _ = ned_from_geo(told.place, support.HOME)
    assert np.hypot(north - TRUTH[0], east - TRUTH[1]) < 1.0


def by_descent(support, seed, risen_m):
    """Of `iclk`: distance from the truth, the same over what is claimed in that direction, and the largest claimed 1-sigma."""
    request = support.request_at((2.0, 0.0, -238.0), (0.0, 0.0, 0.62), sigma_m=8.0)
    seen = support.render(lake(support, seed, 200 + seed, risen_m, contrast=0.3), MODEL, TRUTH, LEVEL)
    told = IclkLocaliser(MODEL, LocaliserSettings(), GRADIENT).localise(request, seen, lake(support, seed, 100, contrast=0.3))
    assert isinstance(told, Fix), told
    off = np.array(ned_from_geo(told.place, support.HOME)[:2]) - TRUTH[:2]
    covariance = np.array(told.cov_ne_m2)
    return np.hypot(*off), np.sqrt(off @ np.linalg.solve(covariance, off)), np.sqrt(np.linalg.eigvalsh(covariance)[-1])


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_a_descent_that_a_moved_shore_has_drawn_aside_claims_it(support, seed):
    """2.8 to 3.2 m off, 1.8 to 2.1 times the claim before."""
    off_m, sigmas, _ = by_descent(support, seed, 4.0)
    assert off_m > 2.0
    assert sigmas < 1.3


@pytest.mark.parametrize("seed", [0, 1])
def test_a_descent_beside_water_that_is_where_it_was_claims_what_it_did(support, seed):
    off_m, sigmas, claimed_m = by_descent(support, seed, 0.0)
    assert off_m < 1.0
    assert sigmas < 1.0
    assert claimed_m == pytest.approx(1.31, abs=0.1)
