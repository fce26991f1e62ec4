from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.geo.se3 import euler_from_quat
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.iclk import IclkLocaliser, probability_wrong, regressors
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.types import CameraModel, Fix, GeoPoint, NoFix

HOME = GeoPoint(47.0, 8.0, 0.0)
MODEL = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)


def localiser() -> IclkLocaliser:
    return IclkLocaliser(MODEL, LocaliserSettings(), GRADIENT)


def resampled() -> IclkLocaliser:
    """On features that are computed once and resampled, as a network's are."""
    return IclkLocaliser(MODEL, LocaliserSettings(), replace(GRADIENT, tolerance=(math.radians(12), 0.15)))


def off_m(answer: Fix | NoFix, p_ned_m: tuple[float, float, float]) -> tuple[float, float]:
    assert isinstance(answer, Fix), answer
    north, east, down = ned_from_geo(answer.place, HOME)
    return math.hypot(north - p_ned_m[0], east - p_ned_m[1]), abs(down - p_ned_m[2])


@pytest.mark.parametrize(("world", "euler"), [("flat", (0.0, 0.0, 0.6)), ("hilly", (0.2, -0.3, 2.5))])
def test_descent_from_the_prior_ends_at_the_true_pose(world, euler, support, request):
    """The published setting: off by a tenth of the footprint, 7 degrees and 4 % of the height; over hills and tilted too."""
    ref = request.getfixturevalue(world)
    truth = (23.0, -41.0, -235.0)
    prior = support.request_at((13.0, -32.0, -240.0), (euler[0], euler[1], euler[2] + 0.12), sigma_h_m=12.0, sigma_yaw_deg=10.0)
    answer = localiser().localise(prior, support.render(ref, MODEL, truth, euler), ref)
    horizontal, vertical = off_m(answer, truth)
    assert horizontal < 0.5
    assert vertical < 0.8
    assert isinstance(answer, Fix)
    assert abs(euler_from_quat(answer.q_ned_frd)[2] - euler[2]) < 0.01
    assert answer.sigma_h_m < 3.0
    assert 0 < answer.cov_ne_m2[0][0] < 4.0


def test_features_computed_once_and_resampled_do_as_well(flat, support):
    truth = (23.0, -41.0, -235.0)
    prior = support.request_at((17.0, -35.0, -238.0), (0.0, 0.0, 0.68), sigma_h_m=8.0, sigma_yaw_deg=6.0)
    horizontal, vertical = off_m(resampled().localise(prior, support.render(flat, MODEL, truth, (0.0, 0.0, 0.6)), flat), truth)
    assert horizontal < 0.6
    assert vertical < 1.0


def test_a_prior_beyond_the_reach_of_the_descent_is_declined(flat, support):
    truth = (60.0, -70.0, -240.0)
    frame = support.render(flat, MODEL, truth, (0.0, 0.0, 0.6))
    answer = localiser().localise(support.request_at((-30.0, 30.0, -240.0), (0.0, 0.0, 0.6), sigma_m=60.0), frame, flat)
    assert isinstance(answer, NoFix)
    assert answer.reason in {Reason.NO_MATCH, Reason.REFINEMENT_DIVERGED}
    assert dict(answer.evidence)["p_wrong"] > 0.05


def test_frame_beside_the_map_is_declined(flat, support):
    frame = support.render(flat, MODEL, (0.0, 0.0, -240.0), (0.0, 0.0, 0.6))
    for north in (240.0, 290.0, 320.0):
        answer = localiser().localise(support.request_at((north, 0.0, -240.0), (0.0, 0.0, 0.6)), frame, flat)
        assert isinstance(answer, NoFix)


def test_belief_grows_with_likeness_and_falls_with_distance_from_the_prior():
    numbers = {"score": 0.6, "footprint_px": 173.0}
    near = numbers | dict.fromkeys(("position_sigmas", "yaw_sigmas", "height_sigmas"), 0.3)
    p = probability_wrong(regressors(near))
    assert p < 0.02
    assert probability_wrong(regressors(near | {"score": 0.1})) > 0.5
    assert probability_wrong(regressors(near | {"yaw_sigmas": 4.0, "height_sigmas": 4.0})) > p
    assert np.isfinite(probability_wrong(regressors(near | {"score": 1e9})))
