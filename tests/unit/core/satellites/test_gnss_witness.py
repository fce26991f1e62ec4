"""Over one ground all fixes are one witness against GNSS."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.unit.core.conftest import place_of
from visloc_companion.core.filter.separation import CLAIM_FLOOR
from visloc_companion.core.filter.votes import GROUNDS
from visloc_companion.core.satellites.drift import DriftTest
from visloc_companion.core.satellites.gnss_witness import FURTHER_ON, REACH_M, Ground, Grounds
from visloc_companion.core.satellites.other_causes import Cause, OtherCauses
from visloc_companion.core.settings import GnssSettings
from visloc_companion.types import Fix, LocaliseRequest, Verdict

World = Any
S = 1_000_000_000
THRESHOLD = GnssSettings().drift_threshold


def wrong_world(world: type[World]) -> type[World]:
    class Wrong(world):  # type: ignore[misc]
        """Fixes over the ground from `since_m` to `until_m` north are off by `off_m` to the east, all in the same way."""

        since_m, until_m, off_m, claim, length_m = -1e3, 1e3, 14.0, 0.02, 1e6

        def velocity(self, t_s: float) -> tuple[float, float]:
            turns = int(t_s * self.speed_mps // self.length_m)
            return self.speed_mps if turns % 2 == 0 else -self.speed_mps, 0.0

        def _localise(self, request: LocaliseRequest) -> None:
            super()._localise(request)
            when, found = self.answers[-1]
            if not isinstance(found, Fix):
                return
            if self.since_m <= self.p[0] < self.until_m:
                to = place_of(self.p + np.array([0.0, self.off_m]) + self.fix_sigma_m * self.rng.standard_normal(2))
                found = replace(found, place=to)
            self.answers[-1] = when, replace(found, probability_wrong=self.claim)

    return Wrong


def trusted(w: World, since_s: float = 2.0) -> bool:
    return all(status.verdict is Verdict.OK for t, status, _ in w.statuses if t > since_s)


@pytest.mark.parametrize("claim", [0.002, 0.02])
def test_a_match_that_is_wrong_from_the_first_frame_on_where_a_copter_hovers_calls_no_gnss_false(
    world: type[World], claim: float
) -> None:
    """It was called false after 6 s, and the vehicle went 17 m off on vision."""
    w = wrong_world(world)(speed_mps=0.0)
    w.claim = claim
    w.start()
    w.fly(150)
    assert trusted(w)


@pytest.mark.parametrize("off_m", [20.0, 40.0])
def test_nor_does_one_that_is_come_back_to(world: type[World], off_m: float) -> None:
    """To and fro over 100 m, of which 30 m are wrong: several times it was called false each time."""
    w = wrong_world(world)(speed_mps=2.0)
    w.since_m, w.until_m, w.length_m, w.off_m = 60.0, 90.0, 100.0, off_m
    w.start()
    w.fly(200)
    assert trusted(w)


@pytest.mark.parametrize("rate_mps", [1.0, 3.0])
def test_a_drag_beside_a_copter_that_sees_once_in_a_while_is_found_by_the_second_look_that_shows_it(
    world: type[World], rate_mps: float
) -> None:
    """It took four looks, 140 s: what spoke against GNSS was forgotten with the next one."""
    pull_m, seldom = (lambda t: (0.0, rate_mps * max(0.0, t - 100.0))), (lambda t: t % 40.0 > 0.6)
    w = world(speed_mps=0.0, pull_m=pull_m, blind=seldom)
    w.start()
    w.fly(159.0)
    assert trusted(w)
    w.fly(162.0)
    assert w.notices("GNSS not trusted, camera says elsewhere")


@pytest.mark.parametrize(("speed_mps", "within_s"), [(0.0, 4.0), (2.0, 4.0), (10.0, 4.0)])
def test_a_gnss_that_jumps_beside_fixes_that_go_on_is_found_at_once(
    world: type[World], speed_mps: float, within_s: float
) -> None:
    w = wrong_world(world)(speed_mps=speed_mps, pull_m=lambda t: (0.0, 15.0 if t > 40.0 else 0.0))
    w.off_m, w.since_m, w.until_m = 0.0, 1e6, 1e6
    w.start()
    w.fly(40.0)
    assert trusted(w)
    w.fly(40.0 + within_s)
    assert w.notices("GNSS not trusted, camera says elsewhere")


def told(grounds: Grounds, *looked_at: Ground) -> list[Cause]:
    for k, ground in enumerate(looked_at):
        place = grounds.see(k * S, ground)
    return grounds.causes({place: 1.0})


def at(north_m: float, method: str = "image", **more: Any) -> Ground:
    return Ground(method, (north_m, 0.0), 24.0, 0.01, **more)


def test_the_same_ground_is_one_cause_however_often_it_is_seen_and_each_other_method_another_one() -> None:
    assert [c.key for c in told(Grounds(), at(0.0), at(10.0), at(-5.0))] == [("image", 1, 1)]
    assert {c.key for c in told(Grounds(), at(0.0), at(0.0, "structure"))} == {("image", 1, 1), ("structure", 1, 1)}


def test_other_ground_is_a_cause_of_its_own_and_goes_on_with_the_one_before_less_probably() -> None:
    causes = {c.key: c for c in told(Grounds(), at(0.0), at(24.0))}
    assert set(causes) == {("image", 1, 1), ("image", 1, 2), ("image", 2, 2)}
    assert [causes["image", *key].adds for key in ((1, 1), (1, 2), (2, 2))] == [0.0, 1.0, 1.0]
    less = causes["image", 1, 1].log_probability - causes["image", 1, 2].log_probability
    assert np.exp(-less) == pytest.approx(FURTHER_ON)
    back = told(Grounds(), at(0.0), at(24.0), at(1.0))
    assert [c.adds for c in back] == [1.0, 1.0, 0.0]


def test_a_match_is_wrong_as_probably_as_its_fixes_claim_on_average() -> None:
    """The largest of many claims says more than is known."""
    (cause,) = told(Grounds(), at(0.0), at(1.0)._replace(claimed=0.04), at(2.0)._replace(claimed=0.0))
    assert np.exp(cause.log_probability) == pytest.approx((0.01 + 0.04 + CLAIM_FLOOR) / 3)


def test_no_more_grounds_are_remembered_than_the_filter_remembers() -> None:
    grounds = Grounds()
    told(grounds, *(at(100.0 * k) for k in range(40)))
    assert len({c.key[1] for c in grounds.causes({}) if isinstance(c.key, tuple)}) == GROUNDS


def test_a_fix_far_from_where_the_vehicle_was_is_another_match_of_the_same_ground() -> None:
    grounds = Grounds()
    causes = told(grounds, at(0.0), at(2.0, off_ne_m=(10.0, 0.0), off_var_m2=4.0))
    assert [(c.key[1], c.size, c.known) for c in causes if isinstance(c.key, tuple)][-1] == (2, -10.0, 0.25)
    told(grounds, at(2.0, off_ne_m=(-10.0, 0.0), off_var_m2=4.0))
    assert {c.key[1] for c in grounds.causes({}) if isinstance(c.key, tuple)} == {1, 3}


def test_a_row_of_other_matches_leads_no_further_on_the_same_ground() -> None:
    """Each lay nearer than a spacing to the one before, and none was of other ground, however far the vehicle went."""
    grounds = Grounds()
    for k in range(12):
        off = (9.0, 0.0) if k % 2 else None
        place = grounds.see(k * S, at(16.0 * k, off_ne_m=off, off_var_m2=4.0))
    causes = {c.key: c for c in grounds.causes({place: 1.0})}
    newest = max(number for _, _, number in causes)
    assert causes["image", 1, newest].log_probability < causes["image", 1, 1].log_probability + 4 * np.log(FURTHER_ON)


def test_a_cause_that_is_told_no_more_is_kept_while_it_explains_something() -> None:
    causes, h, none = OtherCauses(4, (10.0,), 2), np.array([1.0, 1.0, 1.0, 0.0]), np.zeros(4, dtype=complex)
    for _ in range(20):
        causes.sum_up([Cause("wrong", None, -5.0, 1.0), Cause("idle", None, -12.0, 0.0)], 9.0 + 0j, h, none, 4.0)
    explained = causes.log_explained()
    assert explained > 50.0
    causes.sum_up([], 0j, h, none, 4.0)
    assert causes.log_explained() == pytest.approx(explained)


def test_what_is_measured_of_a_causes_size_makes_it_no_likelier_but_ties_it() -> None:
    h, none = np.array([1.0, 1.0, 1.0, 0.0]), np.zeros(4, dtype=complex)
    explained = {}
    for size in (0.0, 9.0, -9.0):
        causes = OtherCauses(4, (10.0,), 2)
        causes.sum_up([Cause("wrong", None, -5.0, 0.0, complex(size), 1.0)], 0j, h, none, 4.0)
        assert causes.log_explained() < np.log1p(np.exp(-4.9))
        for _ in range(5):
            causes.sum_up([Cause("wrong", None, -5.0, 1.0, complex(size), 1.0)], 9.0 + 0j, h, none, 4.0)
        explained[size] = causes.log_explained()
    assert explained[9.0] > explained[0.0] + 10.0
    assert explained[-9.0] < 0.1


def log_r_over_one_ground(off_m: float) -> float:
    """After 20 s of fixes of 1 m a second over one ground, beside a GNSS that has been so far off since before the first."""
    test, ground = DriftTest(2.0), Ground("deep", (0.0, 0.0), 30.0, 0.002)
    rng = np.random.default_rng(4)
    for k in range(20):
        north, east = rng.standard_normal(2)
        test.add(k * S, (off_m + float(north), float(east)), 1.0, 1.0, ground=ground)
    return test.log_r


def test_what_no_search_beside_gnss_reaches_is_no_wrong_match() -> None:
    """177 m off since the filter began anew: such differences are weighed down, and looked like a match 30 m off."""
    assert log_r_over_one_ground(177.0) > THRESHOLD
    assert log_r_over_one_ground(0.9 * REACH_M) < THRESHOLD
