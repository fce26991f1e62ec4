"""The turn between two frames from followed points."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler
from visloc_companion.localise.odometry.turn_solve import Turned, solved
from visloc_companion.types import FloatArray

FOCAL_PX = 210.0


def attitude(roll_deg: float, pitch_deg: float, yaw_deg: float) -> FloatArray:
    return R_from_quat(quat_from_euler(*(math.radians(a) for a in (roll_deg, pitch_deg, yaw_deg)))) @ R_FRD_CAM


def seen(
    moved: tuple[float, float, float] = (0.08, 0.03, 0.0),
    turn_deg: tuple[float, float, float] = (2.0, -1.5, 3.0),
    relief: float = 0.03,
    slope: tuple[float, float] = (0.0, 0.0),
    wrong: float = 0.0,
    told_deg: tuple[float, float, float] = (0.0, 0.0, 0.0),
    n: int = 90,
    noise_px: float = 0.1,
    seed: int = 1,
) -> tuple[Turned | None, FloatArray, FloatArray]:
    """What is found of points on ground at height 1 with `relief`, the true turn, and its error (3,) in degrees."""
    rng = np.random.default_rng(seed)
    R_a, R_b = attitude(1, -3, 40), attitude(1 + turn_deg[0], -3 + turn_deg[1], 40 + turn_deg[2])
    x = np.column_stack([rng.uniform(-0.7, 0.7, n), rng.uniform(-0.5, 0.5, n), np.ones(n)])
    normal = R_a[2] + R_a.T[:, :2] @ np.array(slope)
    p = x / (x @ normal)[:, None] * (1 + rng.normal(0, relief, n))[:, None]
    q = (p @ R_a.T - np.array(moved)) @ R_b
    xy = q[:, :2] / q[:, 2:] + rng.normal(0, noise_px / FOCAL_PX, (n, 2))
    xy[: round(wrong * n)] += rng.uniform(-0.3, 0.3, (round(wrong * n), 2))
    R_start = attitude(1 + told_deg[0], -3 + told_deg[1], 40 + told_deg[2]).T @ R_a
    found = solved(x, xy, R_start, R_a, FOCAL_PX)
    R_ba = R_b.T @ R_a
    if found is None:
        return None, R_ba, np.full(3, np.nan)
    off = found.R_ba @ R_ba.T
    return found, R_ba, np.degrees([off[2, 1], off[0, 2], off[1, 0]])


@pytest.mark.parametrize("relief", [0.0, 0.03, 0.1])
def test_it_is_found_over_flat_and_rough_ground(relief: float) -> None:
    for seed in range(5):
        found, _, error = seen(relief=relief, seed=seed)
        assert found is not None
        assert np.abs(error).max() < 0.3
        assert found.fitting > 0.8


def test_neither_the_start_nor_wrong_tracks_nor_slopes_matter() -> None:
    for told in ((0.0, 0.0, 0.0), (8.0, -6.0, -9.0)):
        found, _, error = seen(told_deg=told, wrong=0.25, slope=(0.1, -0.05))
        assert found is not None
        assert np.abs(error).max() < 0.3


def test_claims_hold() -> None:
    ratios = []
    for seed in range(40):
        found, _, error = seen(relief=0.05, seed=seed)
        assert found is not None
        ratios.append(error / np.degrees(np.sqrt(np.diag(found.covariance))))
    rms = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert (rms > 0.3).all()
    assert (rms < 1.3).all()


def test_a_wood_beside_a_field_bends_no_turn_where_it_is_known() -> None:
    """A wood of a fifth of the height in a quarter of the picture, and a way of 3 % of the height from frame to frame."""
    errors, claims = {True: [], False: []}, {True: [], False: []}
    for seed in range(40):
        rng = np.random.default_rng(seed)
        R_a, R_b = attitude(1, -3, 40), attitude(2, -4, 41)
        x = np.column_stack([rng.uniform(-0.7, 0.7, 90), rng.uniform(-0.5, 0.5, 90), np.ones(90)])
        wood = (x[:, :2] > 0).all(1)
        height = np.where(wood, 0.8, 1.0) * (1 + rng.normal(0, 0.02, 90))
        p = x * (height / (x @ R_a[2]))[:, None]
        q = (p @ R_a.T - np.array([0.01, 0.03, 0.0])) @ R_b
        xy = q[:, :2] / q[:, 2:] + rng.normal(0, 0.1 / FOCAL_PX, (90, 2))
        for known in (True, False):
            found = solved(x, xy, R_b.T @ R_a, R_a, FOCAL_PX, np.where(wood, 1.25, 1.0) if known else 1.0)
            assert found is not None
            off = found.R_ba @ (R_b.T @ R_a).T
            errors[known].append(np.degrees([off[2, 1], off[0, 2], off[1, 0]]))
            claims[known].append(np.degrees(np.sqrt(np.diag(found.covariance))))
    mean = {known: np.abs(np.mean(errors[known], axis=0)).max() for known in errors}
    assert mean[True] < 0.01 < 0.015 < mean[False], "frame after frame it would be the same"
    assert np.mean(claims[True]) < np.mean(claims[False])
    assert np.sqrt(np.mean(np.square(np.array(errors[True]) / np.array(claims[True])))) < 1.3


def test_who_does_not_move_sees_the_turn_best() -> None:
    still, moving = (seen(moved=m, relief=0.05)[0] for m in ((0.0, 0.0, 0.0), (0.3, 0.1, 0.0)))
    assert still is not None
    assert moving is not None
    assert np.trace(still.covariance) < np.trace(moving.covariance)
    assert moving.moved @ attitude(1, -3, 40).T == pytest.approx([0.3, 0.1, 0.0], abs=0.05)


def test_nonsense_is_no_turn() -> None:
    x = np.tile([0.1, 0.1, 1.0], (30, 1))
    assert solved(x, np.full((30, 2), np.nan), np.eye(3), attitude(0, 0, 0), FOCAL_PX) is None
