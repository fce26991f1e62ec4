"""The point-mass filter against the Kalman filter where that is exact, and where only it can hold two places."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from visloc_companion.localise.terrain.elevation import ElevationMap
from visloc_companion.localise.terrain.noise import HeightNoise
from visloc_companion.localise.terrain.point_mass import PointMassFilter, Region

GAUSSIAN = HeightNoise(2.0, standing=0.0, outliers=1e-12)


def test_on_a_linear_slope_it_is_the_kalman_filter(world: SimpleNamespace) -> None:
    slope = np.array([0.12, -0.08])
    half, cell = 600.0, 20.0
    n = int(2 * half / cell) + 1
    v, u = np.mgrid[0:n, 0:n]
    heights = 200 + slope[0] * (v * cell - half) + slope[1] * (u * cell - half)
    model = ElevationMap(heights.astype(np.float32), np.array([[0.0, cell, -half], [cell, 0.0, -half]]), 1.0)
    sigma = (40.0, 30.0, 5.0)
    grid = PointMassFilter(model, Region((0.0, 0.0, 0.0), (170.0, 130.0, 22.0), 4.0, 0.5), GAUSSIAN, sigma)
    x, P = np.zeros(3), np.diag(np.square(sigma))
    H = np.array(
        [*(-slope), 1.0]
    )  # measured less the model at the dead reckoned place: slope times the place's error, and offset
    for k in range(6):
        at = (10.0 * k, -20.0)
        z = 3.0 + 0.5 * k
        grid.observe(at, 200 + slope @ np.array(at) + z, 1.0)
        S = H @ P @ H + 4.0
        K = P @ H / S
        x, P = x + K * (z - H @ x), P - np.outer(K, H @ P)
        grid.carry(9.0)
        P = P + np.diag([9.0, 9.0, 0.0])
    got = grid.estimate()
    assert got.mean_m == pytest.approx(x, abs=0.4)
    assert np.sqrt(np.diag(got.covariance_m2)) == pytest.approx(np.sqrt(np.diag(P)), rel=0.03)


def flown(grid: PointMassFilter, ground: object, true_error: tuple[float, float], offset: float, length_m: float) -> None:
    rng = np.random.default_rng(4)
    for k in range(int(length_m / 30)):
        place = np.array([-1200 + 30.0 * k, 200.0 * np.sin(k / 9)])
        at = place + np.array(true_error)
        height = float(ground(place[None])[0]) + offset + rng.normal(0, 0.5) + (12.0 if rng.random() < 0.3 else 0.0)  # type: ignore[operator]
        grid.observe((float(at[0]), float(at[1])), height, 0.5)
        grid.carry(0.5)
        if k % 10 == 9:
            grid.lay_anew()


def test_it_gathers_at_the_true_place_under_trees(world: SimpleNamespace) -> None:
    ground = world.waves(30)
    region = Region((0.0, 0.0, 0.0), (450.0, 450.0, 12.0), 30.0, 1.5)
    grid = PointMassFilter(world.elevation(ground), region, HeightNoise(1.5))
    flown(grid, ground, (210.0, -120.0), 4.0, 2400.0)
    got = grid.estimate()
    assert grid.cell_m < 15
    assert got.concentrated > 0.9
    assert got.mean_m == pytest.approx([210, -120, 4], abs=8)


def test_level_ground_leaves_it_where_it_was(world: SimpleNamespace) -> None:
    ground = world.waves(0.0)
    grid = PointMassFilter(world.elevation(ground), Region((0.0, 0.0, 0.0), (600.0, 600.0, 9.0), 30.0, 1.5), HeightNoise(1.5))
    flown(grid, ground, (100.0, 0.0), 0.0, 900.0)
    got = grid.estimate()
    assert got.concentrated < 0.5
    assert np.sqrt(got.covariance_m2[0, 0]) > 150


def test_voids_say_nothing(world: SimpleNamespace) -> None:
    void = ElevationMap(np.full((50, 50), np.nan, np.float32), np.array([[0.0, 20.0, -500.0], [20.0, 0.0, -500.0]]), 1.0)
    grid = PointMassFilter(void, Region((0.0, 0.0, 0.0), (100.0, 100.0, 5.0), 20.0, 1.0), HeightNoise(1.5))
    before = grid.p.copy()
    grid.observe((0.0, 0.0), 123.0, 1.0)
    assert grid.p == pytest.approx(before)
