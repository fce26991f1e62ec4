"""First fixes beside a GNSS that moved unlike the camera: who is wrong, and what is sent until that is known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from visloc_companion.core.places.first_fixes import FORGET_NS, FirstFixes
from visloc_companion.core.places.travel import TravelLog
from visloc_companion.geo import wgs84
from visloc_companion.types import Fix, GeoPoint, Injection, LocaliseRequest, Odometry

World = Any
S = 1_000_000_000
ORIGIN = GeoPoint(47.0, 8.0, 400.0)
HEIGHT_M = 100.0
COV = ((0.01, 0.0), (0.0, 0.01))


def fix(t_s: float, north_m: float, sigma_m: float = 1.5) -> Fix:
    place, level = wgs84.geo_from_ned((north_m, 0.0, -HEIGHT_M), ORIGIN), (1.0, 0.0, 0.0, 0.0)
    cov = ((sigma_m**2, 0.0), (0.0, sigma_m**2))
    return Fix(round(t_s * S), round(t_s * S), 1, 1, "deep", place, level, cov, 1.5, 0.05, 0.002, 5.0, ())


def flown(speed_mps: float, until_s: float) -> TravelLog:
    """Northwards since t = 0."""
    travel = TravelLog()
    for k in range(round(10 * until_s) + 1):
        travel.velocity(k * S // 10, (speed_mps, 0.0))
    return travel


def waits(odometry_mps: float, gnss_mps: float, fixes_mps: float, until_s: float = 12.0, offset_m: float = 70.0) -> list[bool]:
    """Whether each fix of a second waits; all three move northwards, and fixes lie `offset_m` beside GNSS at first."""
    asked = FirstFixes(flown(odometry_mps, until_s))
    beside = [(offset_m + (gnss_mps - fixes_mps) * t, 0.0) for t in range(round(until_s))]
    return [asked.waits(fix(t, fixes_mps * t), beside[t], HEIGHT_M) for t in range(round(until_s))]


def test_where_fixes_move_as_odometry_does_they_are_taken_after_a_quarter_of_the_height() -> None:
    assert waits(odometry_mps=10.0, gnss_mps=12.8, fixes_mps=10.0) == [True] * 3 + [False] * 9


def test_from_a_summit_it_is_a_quarter_of_the_height_over_the_valley() -> None:
    asked = FirstFixes(flown(10.0, 12.0))
    seen = [replace(fix(t, 10.0 * t), above_ground_m=2.4 * HEIGHT_M) for t in range(9)]
    assert [asked.waits(each, (70.0 + 2.8 * t, 0.0), HEIGHT_M) for t, each in enumerate(seen)] == [True] * 6 + [False] * 3


def test_where_fixes_move_as_gnss_does_none_is_taken() -> None:
    assert waits(odometry_mps=5.6, gnss_mps=10.0, fixes_mps=10.0) == [True] * 12


def test_after_a_jump_gnss_and_odometry_move_alike_and_fixes_decide() -> None:
    assert waits(odometry_mps=10.0, gnss_mps=10.0, fixes_mps=10.0, offset_m=60.0) == [True] * 3 + [False] * 9


def test_a_fix_that_lies_where_gnss_does_is_taken_at_once() -> None:
    assert waits(odometry_mps=5.6, gnss_mps=10.0, fixes_mps=10.0, offset_m=5.0) == [False] * 12


def test_a_vehicle_that_hovers_is_not_waited_for_longer_than_ten_seconds() -> None:
    assert waits(odometry_mps=0.0, gnss_mps=0.0, fixes_mps=0.0, until_s=14.0) == [True] * 10 + [False] * 4


@pytest.mark.parametrize(("odometry_mps", "waiting"), [(10.0, [True] * 3 + [False] * 4), (5.6, [True] * 7)])
def test_without_gnss_fixes_must_move_as_odometry_does(odometry_mps: float, waiting: list[bool]) -> None:
    asked = FirstFixes(flown(odometry_mps, 8.0))
    assert [asked.waits(fix(t, 10.0 * t), None, HEIGHT_M) for t in range(7)] == waiting


def test_what_waited_is_forgotten_and_a_fix_that_was_taken_ends_it() -> None:
    asked = FirstFixes(TravelLog())
    beside = (70.0, 0.0)
    assert asked.waits(fix(0.0, 0.0), beside, HEIGHT_M)
    assert asked.waits(fix(1.0 + FORGET_NS / S, 210.0), beside, HEIGHT_M), "the first one is too old"
    asked.taken()
    assert not asked.waits(fix(22.0, 220.0), beside, HEIGHT_M)


DRAGGED_S, LAND_S, BESIDE_M = 12.0, 32.0, 70.0


def recognised_late(world: type[World], scale: float, beside_m: float, **faults: Any) -> World:
    """Odometry from the start, off by a factor; fixes from LAND_S on, so far beside the place."""

    @dataclass
    class Late(world):  # type: ignore[misc]
        def _localise(self, request: LocaliseRequest) -> None:
            super()._localise(request)
            when, found = self.answers[-1]
            t1_s = request.frame.t_ns * 1e-9
            t0_s = t1_s - self.fix_period_s
            north, east = scale * np.array(self.velocity((t0_s + t1_s) / 2)) * self.fix_period_s
            motion = Odometry(0, round(t0_s * 1e9), request.frame.t_ns, (float(north), float(east), 0.0), COV, 0.01, 0.03)
            if isinstance(found, Fix):
                found = replace(found, place=wgs84.geo_from_ned((0.0, beside_m, 0.0), found.place))
            self.answers[-1] = (when, replace(found, motion=motion))

    w = Late(blind=lambda t: t < LAND_S, **faults)
    w.start()
    return w


def sent(w: World) -> list[float]:
    return [t for t, command in w.commands if isinstance(command, Injection)]


def test_fixes_of_a_camera_that_is_set_up_wrongly_move_nothing_while_gnss_is_good(world: type[World]) -> None:
    """Pitch configured as 30 degrees and really 0: all lie 70 m beside, odometry sees 56 % of the way."""
    w = recognised_late(world, 0.56, BESIDE_M).fly(LAND_S + 14.0)
    assert w.status_at(LAND_S)[0].verdict.value == "suspect"
    assert not sent(w)
    assert len(w.notices("a first fix waits")) > 10


@pytest.mark.parametrize("drag_mps", [1.0, 3.0])
def test_first_fixes_beside_a_dragged_gnss_are_used_within_seconds(world: type[World], drag_mps: float) -> None:
    w = recognised_late(world, 1.0, 0.0, pull_m=lambda t: (0.0, max(0.0, drag_mps * (t - DRAGGED_S)))).fly(LAND_S + 14.0)
    assert w.status_at(LAND_S)[0].verdict.value == "suspect"
    assert LAND_S < min(sent(w)) < LAND_S + 6.0
    assert max(error for t, _, error in w.statuses if t > min(sent(w))) < 5.0
