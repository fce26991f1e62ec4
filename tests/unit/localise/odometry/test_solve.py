"""Exact points seen from two places: what the solution recovers, and whether its covariance is that of its errors."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler
from visloc_companion.localise.odometry.solve import Ground, MotionPrior, solve

FOCAL = 400.0
D = np.array([30.0, -12.0, 1.0])
LEVEL = R_from_quat(quat_from_euler(0.0, 0.0, 0.7)) @ R_FRD_CAM


def scene(rng, n=150, height=100.0, relief=3.0, tilt_deg=(0.0, 0.0), level=0.0):
    """True points (n, 3) about the plane, and where that plane is believed to be."""
    rays = np.column_stack([rng.uniform(-0.7, 0.7, (n, 2)), np.ones(n)])
    R = R_from_quat(quat_from_euler(*(math.radians(a) for a in (*tilt_deg, 0.0))))
    rays = rays @ R.T
    rays = rays[rays[:, 2] > 0.3 * np.linalg.norm(rays, axis=1)]
    down = height + level + rng.normal(0, relief, len(rays))
    true = rays * (down / rays[:, 2])[:, None]
    return true, rays * (height / rays[:, 2:3])


def ground(believed, spread=3.0, up=0.0, **other):
    plain = np.zeros(len(believed), bool)
    return Ground(believed, np.full(len(believed), spread), plain, 2.0, math.radians(1.0), up, **other)


def seen(rng, true, d, R, noise_px=0.2):
    q = (true - d) @ R
    return q[:, :2] / q[:, 2:3] + rng.normal(0, noise_px / FOCAL, (len(true), 2))


def prior(R, **other):
    given = {"sigma_turn_rad": math.radians(0.2), "sigma_tilt_rad": math.radians(0.5), "sigma_climb_m": 0.3}
    return MotionPrior(R, np.array([20.0, -5.0, 1.0]), float(D[2]), **(given | {"key_axis_ned": LEVEL[:, 2]} | other))


def test_relief_costs_little_and_wrong_tracks_nothing():
    rng = np.random.default_rng(1)
    true, believed = scene(rng)
    xy = seen(rng, true, D, LEVEL)
    xy[:40] += rng.uniform(-0.3, 0.3, (40, 2))
    got = solve(ground(believed), xy, prior(LEVEL), FOCAL)
    assert np.abs(got.d_ned_m - D).max() < 0.4
    assert got.fits[:40].mean() < 0.3
    assert got.fits[40:].mean() > 0.95
    assert got.scatter_px == pytest.approx(0.2, rel=0.4)


@pytest.mark.parametrize("tilt_deg", [(0.0, 0.0), (30.0, -20.0)])
def test_claims_are_the_spread_of_the_errors(tilt_deg):
    """Altitude, turn, relief, level and tracks drawn from what is claimed of them, 120 times."""
    ratios = []
    R = R_from_quat(quat_from_euler(*(math.radians(a) for a in tilt_deg), 0.7)) @ R_FRD_CAM
    for seed in range(120):
        rng = np.random.default_rng(seed)
        true, believed = scene(rng, 80, tilt_deg=tilt_deg, level=rng.normal(0, math.hypot(2.0, 1.5)))
        turn = R_from_quat(quat_from_euler(*rng.normal(0, math.radians(0.2), 3)))
        given = replace(prior(R, sigma_tilt_rad=1e-5), down_m=D[2] + rng.normal(0, 0.3))
        got = solve(ground(believed, up=1.5), seen(rng, true, D, turn @ R), given, FOCAL)
        ratios.append((got.d_ned_m - D) / np.sqrt(np.diag(got.covariance)))
    rms = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert (rms > 0.7).all()
    assert (rms < 1.3).all()


def test_rough_ground_does_not_shrink_the_world():
    """Departures larger than believed are no reason to take everything for nearer, however little is known of the height."""
    rng = np.random.default_rng(2)
    true, believed = scene(rng, 300, relief=9.0)
    got = solve(ground(believed, spread=3.0, up=15.0), seen(rng, true, D, LEVEL), prior(LEVEL), FOCAL)
    assert np.linalg.norm(got.d_ned_m[:2]) == pytest.approx(np.linalg.norm(D[:2]), rel=0.04)
    assert got.roughness > 1.5


@pytest.mark.parametrize("seen_share", [0.7, 1.0, 1.3])
@pytest.mark.parametrize("tilt_deg", [(0.0, 0.0), (30.0, -20.0)])
def test_a_wood_seen_lower_or_higher_than_its_model_tells_no_height(seen_share, tilt_deg):
    """Crowns of 15 m on half of the ground, seen at a share of that: the height that is open stays what it was believed."""
    rng = np.random.default_rng(6)
    key = R_from_quat(quat_from_euler(*(math.radians(a) for a in (*tilt_deg, 0.7)))) @ R_FRD_CAM
    rays = np.column_stack([rng.uniform(-0.6, 0.6, (300, 2)), np.ones(300)]) @ key.T
    crown_m = np.where(np.arange(300) % 2, 15.0, 0.0)
    true, believed = (rays * ((110.0 - share * crown_m) / rays[:, 2])[:, None] for share in (seen_share, 1.0))
    xy, given = seen(rng, true, D, key, 0.1), prior(key, key_axis_ned=key[:, 2])
    spread = np.hypot(0.7, 0.3 * crown_m)
    unsure, sure = (
        solve(replace(ground(believed, up=up), level_m=level_m, slope_rad=1e-4, spread_m=spread), xy, given, FOCAL)
        for up, level_m in ((1.6, 1.0), (1e-3, 1e-3))
    )
    assert np.linalg.norm(unsure.d_ned_m[:2]) == pytest.approx(np.linalg.norm(sure.d_ned_m[:2]), rel=0.003)
    assert unsure.covariance[0, 0] > 10 * sure.covariance[0, 0]  # the height is as open as it was


def test_points_that_a_rangefinder_measured_give_the_scale():
    rng = np.random.default_rng(3)
    true, believed = scene(rng, 200, level=12.0)
    wide = {"up": 15.0, "sigma_range_m": 0.2}
    ranged = np.arange(len(true)) < 8
    mixed = replace(
        ground(np.where(ranged[:, None], true, believed), **wide),
        ranged=ranged,
        spread_m=np.where(ranged, 0.5, 3.0),
        level_m=20.0,
    )
    xy = seen(rng, true, D, LEVEL)
    with_range, without = (solve(g, xy, prior(LEVEL), FOCAL) for g in (mixed, ground(believed, up=15.0)))
    assert np.abs(with_range.d_ned_m - D).max() < 0.4
    assert with_range.covariance[0, 0] < 0.05 * without.covariance[0, 0]
    assert without.shared[0, 0] > 0.9 * without.covariance[0, 0]


def test_heights_read_on_the_way_move_the_ground():
    rng = np.random.default_rng(4)
    true, believed = scene(rng, 150, level=8.0)
    xy = seen(rng, true, D, LEVEL)
    read = np.column_stack([rng.uniform(-40, 40, (12, 2)), 8.0 + rng.normal(0, 2.0, 12)])
    far = replace(ground(believed), level_m=15.0)
    got = solve(replace(far, readings=read, reading_m=2.0), xy, prior(LEVEL), FOCAL)
    blind = solve(far, xy, prior(LEVEL), FOCAL)
    assert abs(got.d_ned_m[0] / D[0] - 1) < 0.02
    assert got.covariance[0, 0] < 0.1 * blind.covariance[0, 0]


def test_points_in_a_row_leave_it_undetermined_only_as_far_as_priors_do():
    """Three coincident points: everything rests on the priors, and the covariance says so."""
    believed = np.tile([[1.0, 1.0, 100.0]], (3, 1))
    xy = seen(np.random.default_rng(0), believed, D, LEVEL, 0.0)
    got = solve(ground(believed), xy, prior(LEVEL), FOCAL)
    assert got is None or got.covariance[0, 0] > (100 * math.radians(0.15)) ** 2


@pytest.mark.parametrize("turn_deg", [(0.0, 0.0), (4.0, 0.0), (-3.0, 10.0)])
@pytest.mark.parametrize("tilt_deg", [(0.0, 0.0), (15.0, 5.0)])
def test_what_a_lens_makes_of_the_displacement_is_told(turn_deg, tilt_deg):
    """Level ground, noise of a hundredth of a pixel, and a lens longer by a thousandth than calibrated."""
    longer = 1e-3
    key = R_from_quat(quat_from_euler(*(math.radians(a) for a in (*tilt_deg, 0.7)))) @ R_FRD_CAM
    second = (
        R_from_quat(quat_from_euler(*(math.radians(a + b) for a, b in zip(tilt_deg, turn_deg, strict=True)), 0.7)) @ R_FRD_CAM
    )
    rng = np.random.default_rng(5)
    rays = np.column_stack([rng.uniform(-0.6, 0.6, (150, 2)), np.ones(150)])
    true = rays @ key.T * (100.0 / (rays @ key.T)[:, 2:])
    xy = seen(rng, true, D, second, 0.01)
    looked = rays * [1 + longer, 1 + longer, 1.0] @ key.T
    believed = {1.0: true, 1 + longer: looked * (100.0 / looked[:, 2:])}
    got = {by: solve(ground(at, 0.5), xy * by, prior(second, key_axis_ned=key[:, 2]), FOCAL) for by, at in believed.items()}
    off_m = (got[1 + longer].d_ned_m - got[1.0].d_ned_m) / longer
    assert got[1.0].by_lens_m == pytest.approx(off_m, abs=0.03 * np.linalg.norm(D) + 0.05 * np.abs(off_m).max())
    assert np.linalg.norm(off_m[:2]) > 20


def test_a_tilt_that_is_claimed_to_be_exact_leaves_the_motion_determined():
    rng = np.random.default_rng(7)
    true, believed = scene(rng)
    got = solve(ground(believed), seen(rng, true, D, LEVEL), prior(LEVEL, sigma_tilt_rad=0.0), FOCAL)
    assert got is not None
    assert np.abs(got.d_ned_m - D).max() < 0.4
