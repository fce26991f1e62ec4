"""What the benchmark of odometry computes itself."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.odometry import Flown, figures, flown, mean_turn, table
from benchmarks.odometry_blind import CASES
from benchmarks.worlds.odometry_world import FRAMES, MODEL, PERIOD_S, Errors, Flight, path_of, sights
from visloc_companion.localise.odometry.base import Surface

EXACT = Errors(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, lens=0.0)


@pytest.fixture
def flight() -> Flight:
    """Six plain frames on a straight line at 100 m."""
    p = np.column_stack([7.0 * np.arange(6), np.zeros(6), np.full(6, -550.0)])
    euler = np.column_stack([np.zeros((6, 2)), np.full(6, 0.3)])
    surface = Surface(np.full((4, 4), 450.0, np.float32), np.array([[0.0, -9.0, 0.0], [9.0, 0.0, 0.0]]))
    frames = np.full((6, MODEL.height_px, MODEL.width_px), 90, np.uint8)
    return Flight("copter-0", "copter", frames, p, euler, np.full(6, 100.0), surface)


@pytest.mark.parametrize(("vehicle", "speed"), [("copter", 10.0), ("plane", 25.0)])
def test_paths_have_the_speed_and_bank_they_state(vehicle: str, speed: float) -> None:
    p, euler = path_of(vehicle, np.random.default_rng(4))
    assert p.shape == (FRAMES, 2)
    assert np.hypot(*np.diff(p, axis=0).T) / PERIOD_S == pytest.approx(speed, rel=0.01)
    bank = float(np.abs(euler[:, 0]).max())
    assert bank < math.radians(50)
    assert (bank > math.radians(20)) == (vehicle == "plane")


def test_what_is_known_is_what_is_given(flight: Flight) -> None:
    rng = np.random.default_rng(0)
    on_map, ranged, home = (sights(flight, EXACT, rng, knows)[2] for knows in ("map", "range", "home"))
    assert on_map.place_ne_m == (14.0, 0.0)
    assert math.isnan(on_map.height_m)
    assert (ranged.height_m, ranged.ranged, math.isinf(ranged.sigma_up_m)) == (100.0, True, True)
    assert (home.height_m, home.ranged, home.sigma_height_m) == (100.0, False, EXACT.home_m)
    assert ranged.t_ns == round(2 * PERIOD_S * 1e9)


def test_an_error_of_roll_is_one_of_heading_where_the_body_leans(flight: Flight) -> None:
    """One degree about an axis that points down by 30 degrees is half a degree about the vertical, though no yaw shows it."""
    euler = flight.euler_rad.copy()
    euler[:, 1] = math.radians(-30.0)
    rolled = euler + np.array([math.radians(1.0), 0.0, 0.0])
    given = sights(replace(flight, euler_rad=rolled), EXACT, np.random.default_rng(0), "map")
    assert mean_turn(given, replace(flight, euler_rad=euler)) == pytest.approx(math.radians(0.5), rel=0.01)


def test_a_flight_without_texture_has_no_legs_and_a_reason(flight: Flight) -> None:
    got = flown(flight, EXACT, 1, "range")
    assert (len(got.legs), got.reasons) == (0, Counter(low_texture=5))
    assert math.isnan(got.off_m)


def test_figures_are_shares_of_the_path_and_of_the_claims(flight: Flight) -> None:
    legs = np.array([[0.3, 0.0, 0.1, 0.1, 0.2, 0.1]])
    one = Flown(flight, legs, np.array([0.2, 0.1, 0.1, 0.1]), 0.7, 0.35, 0.0, Counter(too_dark=2), 20.0)
    got = figures([one, replace(one, off_m=0.0)])
    assert got["drift_worst"] == pytest.approx(0.02)
    assert got["drift"] == pytest.approx(0.02 / math.sqrt(2))
    assert got["drift_known"] == pytest.approx(0.01)
    assert got["leg_error_over_sigma"] == pytest.approx([3.0, 0.0, 2.0])
    assert got["end_error_over_sigma"] == pytest.approx([2.0, 1.0])
    row = table([{"vehicle": "copter", "knows": "map", "sift_ms": 60.0, **got}])[-1]
    assert "too_dark 4" in row
    assert "20, 0.33" in row


def test_what_spoils_frames_keeps_their_size_and_moves_water(flight: Flight) -> None:
    rng = np.random.default_rng(0)
    for name, spoil in CASES.items():
        assert spoil(flight, 3, rng).shape == flight.frames[0].shape, name
    still = replace(flight, p_ned_m=np.repeat(flight.p_ned_m[:1], 6, 0))
    one, later = (CASES["water"](still, k, np.random.default_rng(0)).astype(float) for k in (0, 1))
    assert np.corrcoef(one.ravel(), later.ravel())[0, 1] < 0.9
    assert CASES["night"](flight, 0, rng).max() < 25
