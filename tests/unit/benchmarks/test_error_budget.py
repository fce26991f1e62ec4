"""What the benchmark of the error budget computes from its flights."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks.error_budget import all_sources, body_mean, body_rms, drawn, either_way, flown_of, mean, stated_of, table
from benchmarks.flown.error_budget_flights import Errors
from visloc_companion.evaluate.error_budget import Term


def errors(error_ne_m: tuple[float, float], course_rad: float = math.pi / 2, n: int = 20) -> Errors:
    """Outputs at 10 m/s on one course with a constant error, five fixes in as many seconds that claim 0.65 m."""
    v = 10.0 * np.array([math.cos(course_rad), math.sin(course_rad)])
    t_s = np.linspace(0.0, 5.0, n)
    lean = np.tile([0.02, -0.05], (n, 1))
    wide = np.tile(error_ne_m, (n, 1))
    return Errors(t_s, wide, np.tile(v, (n, 1)), np.full(5, 0.65), np.zeros((5, 2)), lean, np.tile([0.3, 0.4], (n, 1)))


def test_errors_are_turned_to_along_and_across() -> None:
    clean, wrong = errors((0.0, 0.0)), errors((0.2, 1.0))
    assert body_mean(wrong, clean) == pytest.approx([1.0, 0.2])
    assert body_rms(wrong, clean) == pytest.approx([1.0, 0.2])
    assert mean(wrong.error_ne_m) == pytest.approx([0.2, 1.0])


def test_what_both_ways_have_in_common_is_not_the_sources() -> None:
    found = either_way(lambda sign: errors((0.1 + 0.2 * sign, 0.3 + 1.0 * sign)))
    assert found == pytest.approx([1.0, 0.2])


def test_what_is_stated_and_how_it_was_flown_come_from_the_flight() -> None:
    stated, flown = stated_of(errors((0.0, 0.0))), flown_of("copter", errors((0.0, 0.0)))
    assert stated.matching_m == pytest.approx(math.sqrt(0.65**2 - 0.5**2))
    assert set(flown.leans_rad) == {(0.02, -0.05)}
    assert stated.weighed_m == pytest.approx(0.65)
    assert (flown.fix_rate_hz, flown.acceleration_mps2) == pytest.approx((1.0, 0.5))


def test_sources_are_drawn_from_the_seed() -> None:
    stated = stated_of(errors((0.0, 0.0)))
    seen, blind = drawn(stated, 5, pictures=True), drawn(stated, 5, pictures=False)
    assert seen.faults.map_shift_ne_m == blind.map_ne_m
    assert seen.time_s == blind.time_s != drawn(stated, 6, pictures=False).time_s
    assert (seen.matching_m, blind.matching_m) == (0.0, stated.matching_m)
    assert seen.faults.focal_scale != 1.0
    assert all_sources("copter", stated, 0, 0) == {}


def test_terms_that_differ_by_a_third_are_marked() -> None:
    flown = flown_of("copter", errors((0.0, 0.0)))
    terms = [Term("map", 1.0, 1.0), Term("time", 1.0, 0.0)]
    achieved = {"map": Term("map", 1.1, 1.1), "time": Term("time", 0.5, 0.0)}
    lines = table("copter", flown, terms, achieved, {"with pictures": [1.0, 2.0]})
    assert "| map | 1.00, 1.00 | 1.51 | 2.45 | 1.10, 1.10 | 1.66 | 2.69 | 1.10 |" in lines
    assert lines[-3].endswith("0.50 *|") or " 0.50 * |" in lines[-3]
    assert "all, with pictures" in lines[-1]
    assert {line.count("|") for line in lines if line.startswith("|")} == {9}
    assert table("copter", flown, terms, {}, {})[-1].endswith("| | | | |")
