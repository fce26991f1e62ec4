"""What the benchmarks of the camera's time compute themselves."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks.camera_time import HEAD, Learned, Pipeline, figures, line
from benchmarks.camera_time_loop import Conditions, flown
from benchmarks.camera_time_loop import figures as loop_figures
from benchmarks.worlds.camera_time_world import ATTITUDE_S, MODEL, Flight, pilot_of, told
from visloc_companion.geo.se3 import angle_between, quat_from_euler
from visloc_companion.types import GeoPoint


def test_attitudes_told_err_slowly() -> None:
    t = np.arange(0.0, 60.0, ATTITUDE_S)
    true = np.array([quat_from_euler(0.1, -0.1, 0.5) for _ in t])
    off = [angle_between(tuple(a), tuple(b)) for a, b in zip(told(true, t, 3), true, strict=True)]
    assert 0.1 < math.degrees(float(np.sqrt(np.mean(np.square(off))))) < 4
    assert math.degrees(max(abs(a - b) for a, b in zip(off[10:], off, strict=False))) < 0.5


def test_a_plain_picture_teaches_nothing() -> None:
    t = np.arange(0.0, 6.0, ATTITUDE_S)
    q = np.array([quat_from_euler(0.05 * math.sin(2 * s), 0.0, 0.0) for s in t])
    frames = np.full((20, MODEL.height_px, MODEL.width_px), 90, np.uint8)
    flight = Flight("copter-0", frames, 0.2 * np.arange(20) + 1, t, q, q, np.zeros((20, 3)))
    got = Pipeline(flight, 0.3, 0.0, 1).run()
    assert (got.found_s, got.turns, got.error_s) == (None, 0.0, [])


def test_figures_are_of_the_flights_that_found_it() -> None:
    some = [Learned(10.0, [0.003, -0.004], [0.005, 0.005], 2.0, 0.1, 0.9), Learned(None, [], [], 4.0, 0.3, 0.7)]
    got = figures(some)
    assert (got["unknown"], got["found_s"]) == (1, [10.0, 10.0])
    assert got["error_ms"] == pytest.approx([math.sqrt(12.5), 4.0])
    row = line({"vehicle": "plane", "latency_ms": 300.0, "jitter_ms": 0.0, "sift_ms": 60.0, **got})
    assert row.count("|") == HEAD[0].count("|")
    assert (
        line({"vehicle": "plane", "latency_ms": 0.0, "jitter_ms": 0.0, "sift_ms": 60.0, **figures(some[1:])}).count("never") == 1
    )


def test_even_seeds_fly_faster() -> None:
    home = GeoPoint(48.0, 11.0, 500.0)
    assert pilot_of("copter", 1, home).flight.plan.speed_mps == 10.0
    assert pilot_of("plane", 2, home).flight.plan.speed_mps == 25.0


def test_a_flight_in_closed_loop_has_errors_and_repeats() -> None:
    how = Conditions("copter", 15.0, 14.0, 10.0)
    first, again = (flown(how, "late", 3) for _ in range(2))
    assert len(first) >= 30
    assert np.isfinite(first).all()
    assert (first == again).all()
    got = loop_figures([first], [first / 2])
    assert got["grows_by_m"] == pytest.approx(got["rms_m"] / 2)
