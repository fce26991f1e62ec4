import numpy as np
import pytest

from visloc_companion.geo.ray import intersect_surface

CAMERA = np.array([10.0, 20.0, -100.0])


def rays(n: int = 60, spread: float = 0.8) -> np.ndarray:
    rng = np.random.default_rng(5)
    return np.column_stack([rng.uniform(-spread, spread, (n, 2)), np.ones(n)]) * rng.uniform(0.5, 2, (n, 1))


def test_flat_surface_is_the_plane() -> None:
    got = intersect_surface(CAMERA, rays(), lambda p: np.full(len(p), 30.0), 60.0, 0.0)
    assert got == pytest.approx(CAMERA + rays() * (70.0 / rays()[:, 2:]), abs=0.01)


def test_slope_is_met_where_algebra_says() -> None:
    a, b, c = 0.2, -0.15, 25.0
    got = intersect_surface(CAMERA, rays(), lambda p: a * p[:, 0] + b * p[:, 1] + c, 90.0, -60.0)
    r = rays()
    t = (100 - (a * CAMERA[0] + b * CAMERA[1] + c)) / (r[:, 2] + a * r[:, 0] + b * r[:, 1])
    assert got == pytest.approx(CAMERA + r * t[:, None], abs=0.02)


def test_wall_hides_what_is_behind_it() -> None:
    wall = intersect_surface(
        CAMERA, np.array([[0.5, 0.0, 1.0]]), lambda p: np.where(p[:, 0] > 40.0, 60.0, 0.0), highest_up_m=60.0, lowest_up_m=0.0
    )
    assert wall[0, 0] == pytest.approx(40.0, abs=0.02)
    assert wall[0, 2] == pytest.approx(-40.0, abs=0.05)


def test_rays_that_miss_the_surface() -> None:
    def bounded(p: np.ndarray) -> np.ndarray:
        return np.where(np.abs(p).max(axis=1) < 50, 0.0, np.nan)

    got = intersect_surface(CAMERA, np.array([[3.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]), bounded, 10.0, -10.0)
    assert np.isnan(got[:2]).all()
    assert got[2] == pytest.approx([10.0, 20.0, 0.0], abs=0.01)


def test_a_ray_into_a_gap_of_the_surface_meets_nothing_behind_it() -> None:
    """It came out below the far shore of a lake without heights, and was said to meet the ground there, 20 m below it."""

    def lake(p: np.ndarray) -> np.ndarray:
        return np.where(p[:, 0] < 20.0, 0.0, np.where(p[:, 0] < 60.0, np.nan, 10.0))

    near, into, beyond = np.array([[0.1, 0.0, 1.0], [0.5, 0.0, 1.0], [0.8, 0.0, 1.0]])
    got = intersect_surface(np.array([0.0, 0.0, -100.0]), np.stack([near, into, beyond]), lake, 15.0, -40.0)
    assert got[0] == pytest.approx([10.0, 0.0, 0.0], abs=0.05)
    assert np.isnan(got[1]).all()
    assert got[2] == pytest.approx([72.0, 0.0, -10.0], abs=0.05)


def test_a_surface_that_begins_below_the_ray_is_met() -> None:
    got = intersect_surface(
        np.array([0.0, 0.0, -100.0]), np.array([[1.0, 0.0, 1.0]]), lambda p: np.where(p[:, 0] < 50.0, np.nan, 20.0), 90.0, -10.0
    )
    assert got[0] == pytest.approx([80.0, 0.0, -20.0], abs=0.05)


def test_camera_below_the_highest_point() -> None:
    low = np.array([0.0, 0.0, -20.0])
    got = intersect_surface(low, np.array([[1.0, 0.0, 1.0]]), lambda p: np.zeros(len(p)), 500.0, 0.0)
    assert got[0] == pytest.approx([20.0, 0.0, 0.0], abs=0.02)
