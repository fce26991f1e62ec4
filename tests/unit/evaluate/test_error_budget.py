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
    predicted,
    radial_m,
    tilt,
    tilt_seen_rad,
    total,
)

FLOWN = Flown(120.0, 10.0, math.radians(5.0), math.radians(3.0), 0.7, 4.0, 0.25)
HALF_VIEW = (math.radians(30.0), math.radians(23.4))
STATED = Stated(0.5, 0.005, 0.01, math.radians(1.0), math.radians(5.0), 0.4, HALF_VIEW, 35, 0.5)
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


def test_a_tilt_counts_as_far_as_the_picture_does_not_show_it() -> None:
    """By drawing displacements of blocks and fitting place, height and tilt to them."""
    x, y = np.meshgrid(*(np.linspace(-math.tan(half), math.tan(half), 60) for half in HALF_VIEW))
    x, y = x.ravel(), y.ravel()
    zero, one = np.zeros_like(x), np.ones_like(x)
    columns = [np.r_[1 + x * x, x * y], np.r_[one, zero], np.r_[zero, one], np.r_[x, y], np.r_[-y, x]]
    information = np.column_stack(columns).T @ np.column_stack(columns) * STATED.blocks / len(x) * (120.0 / 0.5) ** 2
    seen_rad = math.sqrt(np.linalg.inv(information)[0, 0])
    assert tilt_seen_rad(120.0, STATED) == pytest.approx(seen_rad, rel=0.05)
    narrow = replace(STATED, half_view_rad=(math.radians(5.0), math.radians(4.0)))
    whole_m = 120.0 * STATED.tilt_rad
    assert tilt(FLOWN, STATED).along_m < 0.15 * whole_m
    assert 0.9 * whole_m < tilt(FLOWN, narrow).along_m < whole_m


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
