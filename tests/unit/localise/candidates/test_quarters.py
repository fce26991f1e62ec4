"""Four quarters that show one place and no other are sure of it; one that does is not, nor are four that show two."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from visloc_companion.localise.candidates.quarters import quarters_log_odds
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid
from visloc_companion.localise.verify import QUARTER_WEIGHTS, Evidence, probability_wrong, quarter_regressors

TEMPERATURE, SIDE, FOOT = 1.04, 160, 48
AT = 70, 40
Array = NDArray[np.float32]


def ground(seed: int) -> Array:
    """(SIDE, SIDE, 2) features of ground that no other seed has."""
    return cv2.GaussianBlur(np.random.default_rng(seed).normal(size=(SIDE, SIDE, 2)).astype(np.float32), (0, 0), 1.5) * 3


def grid_of(features: Array, at: tuple[int, int] = (0, 0)) -> MapGrid:
    """A metre a pixel, north down and east to the right, which the sums do not mind."""
    ones = np.ones(features.shape[:2], np.float32)
    return MapGrid(features, ones, 0 * ones, np.array([[0.0, 1.0, at[1]], [1.0, 0.0, at[0]]]), 1.0)


def pose_at(u: float, v: float) -> CameraPose:
    return CameraPose(np.array([v, u, -50.0]), np.eye(3))


def plan_about(pose: CameraPose, sigma_m: float) -> Any:
    half = np.full(2, 3 * sigma_m)
    return SimpleNamespace(pose=pose, cov_ne_m2=np.eye(2) * sigma_m**2, region_half_m=half, within_m=1e9, radius_cap_m=1e9)


def asked(of_map: Array, frame: Array, sigma_m: float = 14.0, weight: Array | None = None) -> float | None:
    """Of a frame (FOOT, FOOT, 2) that a match lays on the map at AT."""
    u, v = AT
    of_place = grid_of(of_map[v : v + FOOT, u : u + FOOT], AT)
    seen = frame, np.ones((FOOT, FOOT), np.float32) if weight is None else weight
    pose = pose_at(u + FOOT / 2, v + FOOT / 2)
    return quarters_log_odds(grid_of(of_map), of_place, seen, pose, plan_about(pose, sigma_m), TEMPERATURE)


def shown(of_map: Array) -> Array:
    return of_map[AT[1] : AT[1] + FOOT, AT[0] : AT[0] + FOOT].copy()


def nats(told: float | None) -> float:
    assert told is not None
    return told


def test_quarters_that_all_show_the_place_are_sure_of_it() -> None:
    of_map = ground(1)
    assert nats(asked(of_map, shown(of_map))) > 15


def test_one_quarter_says_no_more_than_one_can() -> None:
    """Three are of other ground; the score of the whole frame is highest there all the same."""
    of_map = ground(1)
    half = FOOT // 2
    frame = shown(ground(2))
    frame[:half, :half] = 2 * shown(of_map)[:half, :half]
    assert nats(asked(of_map, frame)) < math.log((6 * 14) ** 2)
    assert nats(asked(of_map, frame)) < nats(asked(of_map, shown(of_map))) - 8


def test_a_quarter_that_shows_another_place_of_the_map_does_not_outvote_three() -> None:
    of_map = ground(1)
    half = FOOT // 2
    frame = shown(of_map)
    frame[:half, :half] = of_map[AT[1] + 20 : AT[1] + 20 + half, AT[0] + 20 : AT[0] + 20 + half]
    assert nats(asked(of_map, frame)) > 12


def test_ground_that_is_there_twice_is_not_told_apart() -> None:
    of_map = ground(1)
    of_map[AT[1] : AT[1] + FOOT, 20 : 20 + FOOT] = shown(of_map)
    assert nats(asked(of_map, shown(of_map), sigma_m=25.0)) == pytest.approx(0.0, abs=0.5)


def test_a_place_that_is_not_the_right_one_is_spoken_against() -> None:
    of_map = ground(1)
    elsewhere = of_map[AT[1] + 15 : AT[1] + 15 + FOOT, AT[0] - 20 : AT[0] - 20 + FOOT].copy()
    assert nats(asked(of_map, elsewhere)) < -15


def test_without_another_place_or_anything_in_view_nothing_is_said() -> None:
    of_map = ground(1)
    assert asked(of_map, shown(of_map), sigma_m=0.5) is None
    assert asked(of_map, shown(of_map), weight=np.zeros((FOOT, FOOT), np.float32)) is None


def test_a_frame_that_lies_askew_is_asked_by_what_it_shows() -> None:
    of_map = ground(1)
    weight = np.zeros((FOOT, FOOT), np.float32)
    cv2.fillConvexPoly(weight, np.array([[4, 0], [FOOT - 1, 16], [FOOT - 16, FOOT - 1], [0, FOOT - 20]]), 1.0)
    assert nats(asked(of_map, shown(of_map), weight=weight)) > 10


def test_a_sliver_of_a_quarter_is_left_out() -> None:
    of_map = ground(1)
    v, u = np.indices((FOOT, FOOT))
    weight = (u + v <= FOOT + 4).astype(np.float32)
    frame = shown(of_map)
    frame[FOOT // 2 :, FOOT // 2 :] = 7.0
    assert asked(of_map, frame, weight=weight) == asked(of_map, shown(of_map), weight=weight)


GOOD = Evidence(0.6, 0.6, 0.5, 6.0, 0.9, 36.0, 30.0, 64.0, 0.8, 0.5, 0.5, 0.5, 0.5, 0.7, 0.4)


def test_quarters_count_for_a_match_as_far_as_they_tell_places_apart() -> None:
    weights = (1.0,) + 12 * (0.0,)
    said = [probability_wrong(GOOD, weights, q) for q in (-5.0, 0.0, 5.0, 10.0)]
    assert said == sorted(said, reverse=True)
    assert len(set(said)) == len(said)
    assert probability_wrong(GOOD, weights, 40.0) == probability_wrong(GOOD, weights, 25.0)
    vague = replace(GOOD, sigma_px=4.0)
    assert probability_wrong(vague, weights, 40.0) > 0.15  # the place is right, the position is not


def test_what_was_known_before_counts_beside_them() -> None:
    assert len(QUARTER_WEIGHTS) == len(quarter_regressors(0.5, 1.0))
    assert all(w > 0 for w in QUARTER_WEIGHTS[1:])
    for x in (quarter_regressors(0.0, -90.0), quarter_regressors(1.0, 90.0)):
        assert np.isfinite(x).all()
