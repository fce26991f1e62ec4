"""Houses as a camera above their middle sees them, against what a laser has of them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.pair import Pair, make_pair
from visloc_companion.localise.registration.polish import polish
from visloc_companion.localise.registration.settle import Settler
from visloc_companion.localise.registration.similarity import about, moved, scale_of
from visloc_companion.localise.registration.surfaces import surface_of

UP_M, ALONG_RAYS = 90.0, 25
PRIOR = RegistrationPrior(3.0, 1.0, 0.02, 0.01, 0.03, gaussian=True, sigma_far_edge_m=0.5)


def town(rng: np.random.Generator) -> np.ndarray:
    """(14, 5) west, east, south and north sides and heights of houses within 75 m."""
    middle, half = rng.uniform(-65, 65, (14, 2)), rng.uniform(4, 9, (14, 2))
    sides = np.stack([middle - half, middle + half], -1).reshape(14, 4)
    return np.column_stack([sides, rng.uniform(5, 16, 14)])


def within(xy: np.ndarray, house: np.ndarray, wider_m: float = 0.0) -> np.ndarray:
    west, east, south, north, _ = house
    x, y = xy.T
    inside = (x > west - wider_m) & (x < east + wider_m) & (y > south - wider_m) & (y < north + wider_m)
    return np.asarray(inside, dtype=np.bool_)


def surface(houses: np.ndarray, xy: np.ndarray, wider_m: float = 0.0) -> np.ndarray:
    """(N, 3) points on ground and roofs; these reach farther out by `wider_m`."""
    up = np.zeros(len(xy))
    for house in houses:
        up = np.where(within(xy, house, wider_m), house[4], up)
    return np.column_stack([xy, up])


def seen(houses: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Those of the points (N, 3) that nothing stands before, from UP_M above the middle."""
    free = np.ones(len(points), np.bool_)
    for house in houses:
        for share in np.linspace(0.02, 1.0, ALONG_RAYS):
            toward = np.clip(share * (house[4] - points[:, 2]) / (UP_M - points[:, 2]), 0, None)
            free &= ~((toward > 1e-3) & within(points[:, :2] * (1 - toward[:, None]), house))
    return points[free]


def farther_out(houses: np.ndarray, by_m: float) -> np.ndarray:
    """The houses with those sides that look away from the middle farther out."""
    sign = np.sign(houses[:, :4] @ np.array([[1.0, 0], [1, 0], [0, 1], [0, 1]]))
    west, east, south, north = (sign[:, 0] < 0, sign[:, 0] > 0, sign[:, 1] < 0, sign[:, 1] > 0)
    return houses + by_m * np.column_stack([-1.0 * west, east, -1.0 * south, north, np.zeros(len(houses))])


def flown_over(seed: int, wider_m: float, away_m: float = 0.0) -> Pair:
    rng = np.random.default_rng([seed, 3])
    houses = town(rng)
    reference = surface(houses, rng.uniform(-100, 100, (90_000, 2)))
    source = seen(houses, surface(farther_out(houses, away_m), rng.uniform(-60, 60, (30_000, 2)), wider_m))
    reference[:, 2] += rng.normal(0, 0.03, len(reference))
    source[:, 2] += rng.normal(0, 0.15, len(source))
    pair = make_pair(source, reference, PRIOR)
    assert isinstance(pair, Pair)
    return pair


def test_edges_that_stereo_smears_are_no_other_scale_and_no_other_place() -> None:
    """Where edges told place and scale alone, two of these clouds came out 1.2 and 1.9 % too small, by 2.9 and 4.3 of the sigmas
    claimed, and all three off by 0.11 m (rms an axis)."""
    scales, sigmas, shifts = [], [], []
    for seed in (1, 2, 4):
        pair = flown_over(seed, 0.4)
        settler = Settler(pair, PRIOR)
        start = settler.settle(np.eye(4))
        assert start is not None
        refined = settler.polished(start).refined
        scales.append(scale_of(refined.T) - 1)
        sigmas.append(math.sqrt(refined.placed[3, 3]))
        shifts.append((moved(refined.T, pair.centre_m) - pair.centre_m)[:2])
    assert np.abs(scales).max() < 0.008
    assert np.sqrt(np.mean(np.square(np.divide(scales, sigmas)))) < 1.5
    assert np.sqrt(np.mean(np.square(shifts))) < 0.08


@pytest.mark.parametrize("seed", [1, 2, 4])
def test_the_last_steps_end_at_one_scale_from_whichever_they_began(seed: int) -> None:
    """Edges beside hidden ground lie 0.8 m farther out. Where weights were narrow from the first step, and these edges no unknown
    of their own, the clouds came out 1.0 to 1.6 % too small from a start 4 % too small, 0.6 to 0.7 % from one 4 % too large."""
    pair = flown_over(seed, 0.0, 0.8)
    settler = Settler(pair, PRIOR)
    begun = settler.settle(np.eye(4))
    assert begun is not None
    scales, sigmas = [], []
    for scale in (0.96, 1.04):
        start = replace(begun.refined, T=about(pair.centre_m, 0.0, scale, np.zeros(3)))
        found = polish(settler.cells, surface_of(pair.reference), start, PRIOR, np.ones(len(settler.cells.points_m)))
        assert found is not None
        scales.append(scale_of(found.T) - 1)
        sigmas.append(math.sqrt(found.placed[3, 3]))
    assert abs(scales[1] - scales[0]) < 0.001
    assert max(np.abs(scales)) < min(0.005, 1.5 * min(sigmas))
