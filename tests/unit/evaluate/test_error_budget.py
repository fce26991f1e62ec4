"""The terms of the error budget against what they are in closed form."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.evaluate.error_budget import (
    FilterLoop,
    Flown,
    Stated,
    Term,
    calibration,
    heading,
    picture_of,
    predicted,
    radial_m,
    tilt,
    total,
)
from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler
from visloc_companion.localise.ortho_rectify import CameraPose
from visloc_companion.localise.pose import SIGMA_FLOOR, PriorTerm, solve_pose

FLOWN = Flown(120.0, 10.0, ((math.radians(3.0), math.radians(-5.0)),) * 2, 0.7, 4.0, 0.25)
HALF_VIEW = (math.radians(30.0), math.radians(23.4))
STATED = Stated(0.5, 0.005, 0.01, math.radians(1.0), math.radians(5.0), 0.4, 0.6, HALF_VIEW)
SETTINGS = NavigatorSettings()


def test_shares_of_a_round_and_a_flat_error() -> None:
    assert radial_m(Term("", 2.0, 2.0), 0.95) == pytest.approx(2.0 * math.sqrt(-2 * math.log(0.05)), rel=1e-6)
    assert radial_m(Term("", 3.0, 0.0), 0.6827) == pytest.approx(3.0, rel=5e-3)
    assert radial_m(Term("", 0.0, 0.0), 0.95) == 0.0
    rng = np.random.default_rng(1)
    drawn = np.hypot(2.0 * rng.standard_normal(200_000), 0.7 * rng.standard_normal(200_000))
    assert radial_m(Term("", 2.0, 0.7), 0.68) == pytest.approx(np.percentile(drawn, 68), rel=0.01)


def test_squares_add_up_on_each_axis() -> None:
    assert total([Term("a", 3.0, 1.0), Term("b", 4.0, 0.0)]) == Term("total", 5.0, 1.0)


def test_the_budget_names_each_source_once() -> None:
    terms = predicted(FLOWN, STATED, SETTINGS)
    names = ["map", "calibration", "time", "attitude: tilt", "attitude: heading", "matching", "propagation"]
    assert [term.name for term in terms] == names
    assert terms[0] == Term("map", 0.5, 0.5)
    assert terms[2] == Term("time", pytest.approx(0.1), 0.0)
    assert all(term.along_m > 0 for term in terms)


def test_a_longer_lens_moves_a_camera_that_leans() -> None:
    term = calibration(FLOWN, 0.01)
    assert term.along_m == pytest.approx(1.2 * math.tan(math.radians(5.0)))
    assert term.across_m == pytest.approx(1.2 * math.tan(math.radians(3.0)))


def test_a_level_picture_shows_of_a_tilt_what_is_quadratic_in_it() -> None:
    """A tilt of d to the side moves a point at the tangents (x, y) by d (1 + x^2, x y). Place takes the mean, 1 + mean(x^2); what
    is left is var(x^2) + mean(x^2) mean(y^2). A picture that is wider than high shows less of a tilt ahead."""
    noise_m = 0.09
    seen = picture_of(0.0, 0.0, 120.0, STATED, noise_m)
    x2, y2 = (math.tan(half) ** 2 / 3 for half in HALF_VIEW)
    for own2, moved in ((x2, seen.moved_m_per_rad[1, 0]), (y2, seen.moved_m_per_rad[0, 1])):
        seen_2 = (noise_m / 120.0) ** 2 / ((3 * own2) ** 2 * (1 / 5 - 1 / 9) + x2 * y2)
        expected_m = 120.0 * (1 + own2) * seen_2 / (seen_2 + STATED.tilt_rad**2)
        assert abs(moved) == pytest.approx(expected_m, rel=0.02)
    assert seen.moved_m_per_rad[0, 1] < 0.0 < seen.moved_m_per_rad[1, 0]
    assert seen.moved_m_per_rad[0, 0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("lean_deg", [(0.0, 0.0), (25.0, 4.0), (-40.0, 4.0), (0.0, 20.0)])
def test_a_leaning_picture_is_as_the_pose_is_solved(lean_deg: tuple[float, float]) -> None:
    roll, pitch = (math.radians(angle) for angle in lean_deg)
    height_m, noise_m, n = 120.0, 0.12, 16
    K = np.array([[300.0, 0.0, 0.0], [0.0, 300.0, 0.0], [0.0, 0.0, 1.0]])
    R = R_from_quat(quat_from_euler(roll, pitch, 0.0)) @ R_FRD_CAM
    even = (np.arange(n) + 0.5) * 2 / n - 1
    x, y = np.meshgrid(*(np.tan(half) * even for half in HALF_VIEW))
    rays = np.column_stack([x.ravel(), y.ravel(), np.ones(n * n)])
    down = (rays @ R.T)[:, 2]
    ground = rays @ R.T * (height_m / down)[:, None]
    sigma_px = 300.0 * noise_m * down / height_m * np.sqrt(np.sum(down**-3) * down**3) / SIGMA_FLOOR
    truth = CameraPose(np.zeros(3), R)
    expected = picture_of(roll, pitch, height_m, STATED, noise_m)
    wrong_rad = 1e-3
    for axis in (0, 1):
        angles = np.eye(3)[axis] * wrong_rad
        R_ned_body = R_from_quat(quat_from_euler(roll, pitch, 0.0)) @ R_from_quat(quat_from_euler(*angles))
        prior = PriorTerm(R_ned_body @ R_FRD_CAM, STATED.tilt_rad)
        found = solve_pose(ground, 300.0 * rays[:, :2], sigma_px, K, truth, prior)
        assert found is not None
        np.testing.assert_allclose(found.pose.p_ned_m[:2] / wrong_rad, expected.moved_m_per_rad[:, axis], rtol=0.05, atol=0.3)
        np.testing.assert_allclose(found.covariance[:2, :2], expected.covariance_m2, rtol=0.05, atol=0.01)


def test_a_tilt_counts_as_much_as_fixes_are_worth() -> None:
    """Fixes that claim more see less of the tilt; a narrow view sees nothing of it."""
    level = replace(FLOWN, leans_rad=((0.0, 0.0),))
    sure, unsure = (tilt(level, replace(STATED, weighed_m=claimed_m)).along_m for claimed_m in (0.5, 0.9))
    assert 2.0 * sure < unsure < 120.0 * STATED.tilt_rad
    narrow = replace(STATED, half_view_rad=(math.radians(5.0), math.radians(4.0)), weighed_m=2.0)
    assert 0.9 * 120.0 * STATED.tilt_rad < tilt(level, narrow).along_m < 1.01 * 120.0 * STATED.tilt_rad
    either = tilt(replace(FLOWN, leans_rad=((0.0, 0.0), (0.6, 0.0))), replace(STATED, weighed_m=0.7))
    same = tilt(replace(FLOWN, leans_rad=((0.0, 0.0), (-0.6, 0.0))), replace(STATED, weighed_m=0.7))
    assert (either.along_m, either.across_m) == pytest.approx((same.along_m, same.across_m))


def test_more_fixes_average_the_matching_and_sooner_answers_the_motion() -> None:
    matching, propagation = FilterLoop.of(FLOWN, STATED, SETTINGS).shares()
    assert 0.0 < matching < STATED.matching_m
    often = FilterLoop.of(replace(FLOWN, fix_rate_hz=8.0), STATED, SETTINGS).shares()
    assert often[0] < matching
    late = FilterLoop.of(replace(FLOWN, latency_s=2.0), STATED, SETTINGS).shares()
    assert late[1] > 1.5 * propagation


def test_a_compass_counts_where_the_vehicle_accelerates() -> None:
    loop = FilterLoop.of(FLOWN, STATED, SETTINGS)
    assert heading(replace(FLOWN, acceleration_mps2=0.0), STATED.heading_rad, loop).along_m == 0.0
    once, twice = (heading(FLOWN, angle, loop).across_m for angle in (0.05, 0.1))
    assert twice == pytest.approx(2 * once)
