from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.core.estimator import PositionFilter
from visloc_companion.core.filter import by_gnss
from visloc_companion.core.filter.belief import Belief, seeded
from visloc_companion.core.filter.by_gnss import BesideGnss, held, released
from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.exclusion import excluding
from visloc_companion.core.filter.propagation import N_STATES, POSITION, VELOCITY, Drive
from visloc_companion.core.filter.separation import HELD
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.geo import wgs84
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.types import Fix, GeoPoint

S = 1_000_000_000
ORIGIN = GeoPoint(59.3, 18.1, 0.0)
SETTINGS = replace(NavigatorSettings(), map_sigma_m=2.5)
HEIGHT_M, CLAIM_M, SPEED_MPS = 750.0, 8.0, 10.0
FALSE = 0.01


def place(north: float, east: float = 0.0) -> GeoPoint:
    return wgs84.geo_from_ned((north, east, -HEIGHT_M), ORIGIN)


def fix(t_s: float, north: float, east: float = 0.0, claim_m: float = CLAIM_M, heading_deg: float = 0.0) -> Fix:
    t, cov = round(t_s * S), ((claim_m**2, 0.0), (0.0, claim_m**2))
    q = quat_from_euler(0.0, 0.0, math.radians(heading_deg))
    return Fix(t, t, round(10 * t_s), round(10 * t_s), "deep", place(north, east), q, cov, 2.0, 0.1, 1e-3, 5.0, footprint_m=860.0)


def velocity(t_s: float) -> Velocity:
    return Velocity(round(t_s * S), (SPEED_MPS, 0.0, 0.0), HEIGHT_M, 0.3, Drive.AUTOPILOT)


class Flight:
    """Northwards for a while, with two fixes a second that lie so far east, all alike."""

    def __init__(self, off_m: float = 0.0, claim_m: float = CLAIM_M, mounting_deg: float = 0.0) -> None:
        start = seeded(0, (0.0, 0.0), 5.0, 0.3, Drive.AUTOPILOT, SETTINGS)
        self.filter = PositionFilter(SETTINGS, ORIGIN, start, velocity(0.0))
        self.t_s, self.off_m, self.claim_m, self.mounting_rad = 0.0, off_m, claim_m, math.radians(mounting_deg)

    def run(self, seconds: float, gnss_east: float | None = None, heading_deg: float = 0.0) -> Flight:
        for _ in range(round(10 * seconds)):
            self.t_s = round(self.t_s + 0.1, 1)
            self.filter.drive(velocity(self.t_s))
            if round(10 * self.t_s) % 5 == 0:
                seen = fix(self.t_s, SPEED_MPS * self.t_s, self.off_m, self.claim_m, heading_deg)
                self.filter.observe(seen, self.mounting_rad)
            if gnss_east is not None and round(10 * self.t_s) % 10 == 0:
                self.filter.beside_gnss(round(self.t_s * S), place(SPEED_MPS * self.t_s, gnss_east), 3.0)
        return self

    @property
    def belief(self) -> Belief:
        return self.filter.newest

    @property
    def holds(self) -> bool:
        return HELD in self.belief.without.leaves

    def level_m(self, false: float = FALSE) -> float:
        return self.filter.protection_level_m(round(self.t_s * S), false)


def test_a_gnss_that_agrees_makes_the_level_narrower_and_moves_nothing() -> None:
    alone, beside = Flight().run(20), Flight().run(20, gnss_east=0.0)
    assert beside.filter.at(20 * S) == alone.filter.at(20 * S)
    assert beside.level_m() < 0.85 * alone.level_m()
    assert beside.level_m(1.0) == alone.level_m()
    sigmas = math.sqrt(-2 * math.log(SETTINGS.integrity_risk / FALSE))
    own_m = math.sqrt(float(np.linalg.eigvalsh(alone.belief.P[:2, :2])[-1]) + SETTINGS.map_sigma_m**2)
    assert beside.level_m() >= sigmas * own_m, "the filter alone is right where GNSS was false"


def test_a_gnss_that_is_elsewhere_makes_it_reach_there() -> None:
    beside = Flight().run(20, gnss_east=20.0)
    assert beside.level_m() > Flight().run(20).level_m()
    k = beside.belief.without.leaves.index(HELD)
    assert 8.0 < beside.belief.without.x[k, 1] - beside.belief.x[1] < 20.0


def test_it_lasts_while_fixes_err_as_they_did() -> None:
    """On one heading, until fixes look at other ground (0.6 of the height on)."""
    flight, alone = Flight().run(20, gnss_east=0.0), Flight().run(20)
    assert flight.run(15).level_m() < 0.95 * alone.run(15).level_m()
    assert flight.holds
    assert not flight.run(60).holds
    assert flight.level_m() == alone.run(60).level_m()


@pytest.mark.parametrize(("turned_deg", "holds"), [(10.0, True), (30.0, False), (-170.0, False)])
def test_on_another_heading_nothing_is_known(turned_deg: float, holds: bool) -> None:
    assert Flight().run(20, gnss_east=0.0).run(2, heading_deg=turned_deg).holds is holds


@pytest.mark.parametrize("turned_deg", [30.0, -170.0])
def test_a_mounting_that_is_a_state_turns_along(turned_deg: float) -> None:
    told = Flight(mounting_deg=0.5).run(20, gnss_east=0.0).run(10, heading_deg=turned_deg)
    assert told.holds
    assert told.level_m() < 0.98 * told.level_m(1.0)
    assert not told.run(80, heading_deg=turned_deg).holds, "fixes have told as much"


def test_the_heading_counts_from_where_gnss_last_told() -> None:
    flight = Flight().run(20, gnss_east=0.0)
    for heading_deg in (15.0, 30.0, 45.0):
        flight.run(2, gnss_east=0.0, heading_deg=heading_deg)
        assert flight.holds


def test_fixes_that_claim_less_than_gnss_need_none() -> None:
    flight = Flight(claim_m=1.0).run(20, gnss_east=0.0)
    assert not flight.holds
    assert flight.level_m() == Flight(claim_m=1.0).run(20).level_m()


def test_a_filter_that_no_fix_holds_is_left_alone() -> None:
    start = seeded(0, (0.0, 0.0), 50.0, 0.3, Drive.AUTOPILOT, SETTINGS)
    assert not by_gnss.tells(start, 9.0)
    assert held(start, BesideGnss(0, (0.0, 0.0), 9.0), 0).without.leaves == ()


def test_a_position_that_comes_late_is_taken_at_its_time() -> None:
    early, late = Flight().run(20), Flight().run(20)
    told = 18 * S, place(SPEED_MPS * 18, 4.0), 3.0
    late.run(1)
    late.filter.beside_gnss(*told)
    early.filter.beside_gnss(*told)
    early.run(1)
    assert late.level_m() == pytest.approx(early.level_m(), rel=1e-9)
    late.filter.beside_gnss(3 * S, place(SPEED_MPS * 3), 3.0)
    assert late.level_m() == pytest.approx(early.level_m(), rel=1e-9), "what is older than the memory is dropped"


def test_another_origin_moves_it_along() -> None:
    flight = Flight().run(20, gnss_east=6.0)
    level_m = flight.level_m()
    flight.filter.move_origin(wgs84.geo_from_ned((300.0, -200.0, 0.0), ORIGIN))
    assert flight.level_m() == pytest.approx(level_m, rel=1e-4)
    flight.filter.drive(velocity(20.1))
    assert flight.filter.protection_level_m(201 * S // 10, FALSE) == pytest.approx(level_m, rel=0.02)


def test_odometry_never_goes_on_from_it() -> None:
    """It rests on the same fixes: what contradicts these it does not explain."""
    belief = Flight().run(20, gnss_east=15.0).belief
    k, H = belief.without.leaves.index(HELD), np.eye(N_STATES)[VELOCITY]
    x = belief.without.x.copy()
    x[k, VELOCITY] = 3.0
    belief = belief._replace(without=replace(belief.without, x=x), drive=Drive.INERTIAL)
    found = excluding(belief, np.array([3.0, 3.0]), 0.01 * np.eye(2), H)
    assert found is None or HELD not in found.without.leaves
    assert found is None or np.abs(found.x[POSITION] - belief.x[POSITION]).max() < 10.0


def test_fixes_that_have_the_filter_start_elsewhere_end_it() -> None:
    flight = Flight().run(20, gnss_east=0.0)
    flight.off_m = 300.0
    assert flight.run(1).holds
    flight.run(2)
    assert flight.belief.started_ns > 20 * S
    assert not flight.holds


def test_without_it_there_is_nothing_to_release() -> None:
    belief = Flight().run(5).belief
    assert released(belief.without) is belief.without
