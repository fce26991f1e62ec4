"""Two methods that contradict each other again and again: the level reaches both places, for nobody knows who is right."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.core.estimator import PositionFilter
from visloc_companion.core.filter.belief import seeded
from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.propagation import Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.geo import wgs84
from visloc_companion.types import Accepted, Fix, GeoPoint, Rejected

S = 1_000_000_000
ORIGIN = GeoPoint(47.4, 8.5, 400.0)
SETTINGS = NavigatorSettings()
SPEED_MPS, SIGMA_M = 15.0, 1.5


def fix(t_ns: int, north_m: float, east_m: float, method: str, number: int) -> Fix:
    place = wgs84.geo_from_ned((north_m, east_m, -100.0), ORIGIN)
    cov = ((SIGMA_M**2, 0.0), (0.0, SIGMA_M**2))
    return Fix(t_ns, t_ns, number, number, method, place, (1.0, 0.0, 0.0, 0.0), cov, 2.0, 0.1, 0.005, 5.0)


def drive(the_filter: PositionFilter, since_s: float, until_s: float) -> None:
    for k in range(round(10 * since_s), round(10 * until_s) + 1):
        the_filter.drive(Velocity(k * S // 10, (SPEED_MPS, 0.0, 0.0), 500.0, 0.8, Drive.FED_BACK))


def flown(aside_m: float, until_s: int = 40, every: int = 4, structure_s: int = 10, stands: bool = False) -> PositionFilter:
    """North on images four times a second; every so many of them structure instead, from `structure_s` on and so far east of
    them; `stands`: where it was then."""
    rng = np.random.default_rng(1)
    start = Velocity(0, (SPEED_MPS, 0.0, 0.0), 500.0, 0.8, Drive.FED_BACK)
    the_filter = PositionFilter(SETTINGS, ORIGIN, seeded(0, (0.0, 0.0), 5.0, 0.8, Drive.FED_BACK, SETTINGS), start)
    for k in range(1, 4 * until_s + 1):
        drive(the_filter, (k - 1) / 4, k / 4)
        north_m, structure = SPEED_MPS * k / 4, k % every == 0
        noise_n, noise_e = rng.normal(0.0, SIGMA_M, 2).tolist()
        if not structure:
            outcome = the_filter.observe(fix(k * S // 4, north_m + noise_n, noise_e, "image", k))
            assert isinstance(outcome, Accepted)
        elif k >= 4 * structure_s:
            held_m = SPEED_MPS * structure_s if stands else north_m
            outcome = the_filter.observe(fix(k * S // 4, held_m + noise_n, aside_m + noise_e, "structure", k))
            assert isinstance(outcome, Rejected) or aside_m < 5.0
    return the_filter


def level_m(the_filter: PositionFilter, t_s: float) -> float:
    return the_filter.protection_level_m(round(t_s * S))


@pytest.mark.parametrize(("aside_m", "every"), [(20.0, 2), (40.0, 4), (80.0, 8)])
def test_the_level_reaches_the_place_that_another_method_names(aside_m: float, every: int) -> None:
    the_filter = flown(aside_m, every=every)
    north, east, _ = the_filter.at(40 * S).p_ned_m
    assert math.hypot(north - SPEED_MPS * 40, east) < 5.0, "it does not go to and fro"
    assert aside_m < level_m(the_filter, 40.0) < aside_m + 20.0


def test_methods_that_agree_leave_the_level_as_it_is() -> None:
    the_filter = flown(0.0)
    assert the_filter.newest.contradicting == ()
    assert level_m(the_filter, 40.0) < 12.0


def test_fewer_than_would_move_a_filter_say_nothing() -> None:
    the_filter = flown(40.0, structure_s=37)
    assert len(the_filter.newest.contradicting) == 4
    assert level_m(the_filter, 40.0) > 40.0
    assert level_m(flown(40.0, structure_s=38), 40.0) < 12.0


def test_pictures_that_stand_still_say_nothing() -> None:
    assert level_m(flown(40.0, stands=True), 40.0) < 12.0


def test_one_that_agrees_again_takes_it_back_and_so_does_silence() -> None:
    the_filter, silent = flown(40.0), flown(40.0)
    the_filter.observe(fix(40 * S + S // 10, SPEED_MPS * 40.1, 0.0, "structure", 1000))
    assert level_m(the_filter, 40.2) < 12.0
    for k in range(1, 131):
        drive(silent, 40 + (k - 1) / 4, 40 + k / 4)
        silent.observe(fix(40 * S + k * S // 4, SPEED_MPS * (40 + k / 4), 0.0, "image", 1000 + k))
    assert level_m(silent, 69.5) > 40.0
    assert level_m(silent, 72.5) < 12.0


def test_it_moves_with_the_origin() -> None:
    the_filter = flown(40.0)
    before_m = level_m(the_filter, 40.0)
    the_filter.move_origin(GeoPoint(47.41, 8.52, 400.0))
    assert level_m(the_filter, 40.0) == pytest.approx(before_m, rel=1e-3)
