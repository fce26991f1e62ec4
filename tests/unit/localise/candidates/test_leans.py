from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.geo.se3 import R_from_quat, quat_from_euler, quat_from_vector, quat_multiply
from visloc_companion.localise.candidates.leans import MOST_RAD, STEP_RAD, leans
from visloc_companion.localise.pose import heading_and_tilt
from visloc_companion.types import PosePrior, Quat


@pytest.fixture
def prior(support) -> PosePrior:
    return support.request_at((0.0, 0.0, -240.0), (0.0, 0.0, 0.6)).prior


def lean_rad(q: Quat) -> float:
    return math.acos(float(R_from_quat(q)[2, 2]))


def apart_rad(a: Quat, b: Quat) -> float:
    """Between two attitudes whatever their headings."""
    _, tilt = heading_and_tilt(R_from_quat(a), R_from_quat(b))
    return float(np.linalg.norm(tilt))


def test_a_known_lean_is_the_priors(prior):
    assert leans(replace(prior, sigma_tilt_rad=STEP_RAD / 6)) == [prior.q_ned_frd]


@pytest.mark.parametrize("own", [(0.0, 0.0, 0.6), (0.1, -0.25, 2.0)])
@pytest.mark.parametrize("sigma_deg", [5.0, 10.0, 18.0])
def test_no_lean_within_three_sigmas_is_far_from_one_that_is_searched(prior, own, sigma_deg):
    told = replace(prior, q_ned_frd=quat_from_euler(*own), sigma_tilt_rad=math.radians(sigma_deg))
    found = leans(told)
    rng = np.random.default_rng(3)
    furthest = 0.0
    for _ in range(300):
        size, towards = 3 * told.sigma_tilt_rad * math.sqrt(rng.uniform()), rng.uniform(0, 2 * math.pi)
        turn = size * math.cos(towards), size * math.sin(towards), 0.0
        true = quat_multiply(told.q_ned_frd, quat_from_vector(turn))
        if lean_rad(true) <= math.radians(45.0):
            furthest = max(furthest, min(apart_rad(true, q) for q in found))
    assert furthest < 0.75 * STEP_RAD


def test_none_leans_so_far_that_half_of_the_view_is_too_flat(prior):
    found = leans(replace(prior, sigma_tilt_rad=math.radians(18.0)))
    assert 30 <= len(found) <= 60
    assert max(map(lean_rad, found)) <= MOST_RAD + 1e-6
    assert found[0] == prior.q_ned_frd


def test_the_priors_own_lean_is_searched_however_far_it_leans(prior):
    steep = replace(prior, q_ned_frd=quat_from_euler(0.0, math.radians(55.0), 0.0), sigma_tilt_rad=math.radians(6.0))
    assert leans(steep)[0] == steep.q_ned_frd
