from __future__ import annotations

import pytest

from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.motion import Motion
from visloc_companion.core.filter.propagation import Drive
from visloc_companion.core.gnss import GnssMonitor
from visloc_companion.core.gnss_aiding import GnssAiding
from visloc_companion.core.settings import CoreSettings
from visloc_companion.core.tracking import Tracker
from visloc_companion.geo import wgs84
from visloc_companion.types import EkfSource, Fix, GeoPoint, Gnss, Mode, Notice, Verdict

S = 1_000_000_000
ORIGIN = GeoPoint(59.3, 18.1, 40.0)


def at(north: float) -> GeoPoint:
    return wgs84.geo_from_ned((north, 0.0, -100.0), ORIGIN)


def fix(t_s: float, north: float, claim_m: float = 1.0) -> Fix:
    t, cov = round(t_s * S), ((claim_m**2, 0.0), (0.0, claim_m**2))
    return Fix(t, t, 1, 1, "t", at(north), (1.0, 0.0, 0.0, 0.0), cov, 1.0, 0.1, 0.0, 1.0)


class Rig:
    """A hovering vehicle with a seeded filter and a trusted GNSS."""

    def __init__(self) -> None:
        self.tracker, self.monitor = Tracker(CoreSettings().navigator), GnssMonitor(CoreSettings().gnss)
        self.aiding = GnssAiding(CoreSettings(), self.tracker, self.monitor)
        self.tracker.set_origin(ORIGIN)
        self.t = 0.0
        self.notices: list[object] = []
        self.run(3.0, 0.0, seed=False)
        assert self.monitor.trusted
        self.tracker.seed(round(self.t * S), at(0.0), 2.0)

    def run(self, seconds: float, gnss_north: float, mode: Mode = Mode.SHADOW, seed: bool = True, **more: object) -> None:
        for _ in range(round(seconds * 5)):
            self.t += 0.2
            now = round(self.t * S)
            self.tracker.drive(Velocity(now, (0.0, 0.0, 0.0), 140.0, 0.3, Drive.AUTOPILOT), now, alone=False)
            gnss = Gnss(now, now, 3, 12, at(gnss_north), 1.0, None, None, **more)  # type: ignore[arg-type]
            self.notices += self.aiding.on_gnss(gnss, now, mode)
            self.monitor.update(now, EkfSource.GNSS)

    def north(self) -> float:
        state = self.tracker.at(round(self.t * S))
        assert state is not None
        return state.p_ned_m[0]


def test_trusted_gnss_keeps_an_idle_filter_near() -> None:
    rig = Rig()
    rig.run(60, 6.0)
    assert 4.5 < rig.north() < 6.5


def test_not_while_fixes_come() -> None:
    rig = Rig()
    for _ in range(20):
        rig.tracker.observe(fix(rig.t, 0.0))
        rig.run(2, 6.0)
    assert abs(rig.north()) < 0.3


def test_rare_fixes_hold_a_filter_that_refuses_gnss_in_between() -> None:
    """Two refusals between two fixes, and one of the second fix: the fifth had the filter start from GNSS, 300 m beside the
    fixes, before they could say of it that it is false."""
    rig = Rig()
    for _ in range(8):
        rig.tracker.observe(fix(rig.t, 0.0))
        rig.run(7, 300.0)
    assert rig.notices == []
    assert abs(rig.north()) < 1.0
    rig.run(8, 300.0)
    assert rig.north() > 290.0, "without fixes GNSS is right"


def test_not_while_injecting_and_not_from_another_receiver_or_an_impossible_place() -> None:
    rig = Rig()
    rig.run(30, 6.0, mode=Mode.AIDING)
    rig.run(30, 6.0, receiver=1)
    assert abs(rig.north()) < 0.01
    now = round(rig.t * S)
    assert rig.aiding.on_gnss(Gnss(now, now, 3, 12, GeoPoint(0.0, 0.0, 0.0), 1.0, None, None), now, Mode.SHADOW) == []
    assert rig.aiding.on_gnss(Gnss(now, now, 1, 12, at(6.0), 1.0, None, None), now, Mode.SHADOW) == []
    assert abs(rig.north()) < 0.01


def test_not_when_gnss_is_not_trusted() -> None:
    rig = Rig()
    for _ in range(10):
        rig.t += 0.2
        now = round(rig.t * S)
        rig.aiding.on_gnss(Gnss(now, now, 1, 3, at(0.0), 1.0, None, None), now, Mode.SHADOW)
        rig.monitor.update(now, EkfSource.GNSS)
    assert rig.monitor.verdict.verdict is Verdict.DENIED
    rig.run(15, 6.0)
    assert abs(rig.north()) < 0.01


def level_m(rig: Rig) -> float:
    level = rig.tracker.protection_level_m(round(rig.t * S))
    assert level is not None
    return level


def jammed(rig: Rig) -> None:
    """A second and a half later GNSS is denied."""
    for _ in range(10):
        rig.t += 0.2
        now = round(rig.t * S)
        rig.tracker.drive(Velocity(now, (0.0, 0.0, 0.0), 140.0, 0.3, Drive.AUTOPILOT), now, alone=False)
        rig.aiding.on_gnss(Gnss(now, now, 1, 3, at(0.0), 1.0, None, None), now, Mode.SHADOW)
        rig.monitor.update(now, EkfSource.GNSS)
        rig.aiding.judged(now)
    assert not rig.monitor.trusted


def test_the_level_reckons_that_a_gnss_which_alone_held_the_filter_was_dragged() -> None:
    rig = Rig()
    rig.tracker.observe(fix(rig.t, 0.0))
    rig.aiding.judged(round(rig.t * S))
    rig.run(40, 0.0)
    before_m = level_m(rig)
    jammed(rig)
    assert level_m(rig) > before_m + 3.5 * 0.8 * 40
    for _ in range(3):
        rig.t += 0.5
        rig.tracker.observe(fix(rig.t, 0.0))
    assert level_m(rig) < before_m


def test_no_drag_is_reckoned_with_where_fixes_came_until_now() -> None:
    rig = Rig()
    rig.aiding.judged(round(rig.t * S))
    for _ in range(20):
        rig.tracker.observe(fix(rig.t, 0.0))
        rig.run(2, 0.0)
    before_m = level_m(rig)
    jammed(rig)
    assert level_m(rig) < 1.5 * before_m


def told(gnss_north: float, seconds: int = 20) -> tuple[Rig, float]:
    """A vehicle whose fixes claim 8 m and agree, beside a GNSS; and its level where nothing is made of that."""
    rig = Rig()
    for _ in range(seconds):
        rig.tracker.observe(fix(rig.t, 0.0, 8.0))
        rig.run(1, gnss_north)
        rig.aiding.compare(fix(rig.t, 0.0))
        rig.aiding.judged(round(rig.t * S))
    false, rig.tracker.gnss_false = rig.tracker.gnss_false, 1.0
    alone_m, rig.tracker.gnss_false = level_m(rig), false
    return rig, alone_m


def test_a_trusted_gnss_tells_how_far_off_fixes_are_that_claim_much() -> None:
    rig, alone_m = told(0.0)
    assert rig.tracker.gnss_false == max(0.01, rig.monitor.verdict.probability_false)
    assert level_m(rig) < 0.9 * alone_m
    assert level_m(rig) > 0.7 * alone_m
    assert abs(rig.north()) < 0.01
    elsewhere, alone_m = told(12.0)
    assert level_m(elsewhere) > level_m(rig) + 3.0
    assert abs(elsewhere.north()) < 0.01


def test_what_a_gnss_told_that_is_jammed_is_kept() -> None:
    rig, _ = told(0.0)
    before = rig.tracker.gnss_false
    jammed(rig)
    assert rig.monitor.verdict.verdict is Verdict.DENIED
    assert rig.tracker.gnss_false == before
    kept_m, rig.tracker.gnss_false = level_m(rig), 1.0
    assert kept_m < 0.95 * level_m(rig)


def test_what_a_gnss_told_that_is_found_false_is_not() -> None:
    """Nobody knows since when it was."""
    rig, _ = told(0.0)
    before_m = level_m(rig)
    for _ in range(20):
        rig.tracker.observe(fix(rig.t, 0.0, 8.0))
        rig.run(1, 60.0)
        rig.aiding.compare(fix(rig.t, 0.0))
        rig.aiding.judged(round(rig.t * S))
    assert rig.monitor.verdict.verdict is Verdict.SUSPECT
    assert rig.tracker.gnss_false == 1.0
    assert level_m(rig) > before_m
    jammed(rig)
    assert rig.tracker.gnss_false == 1.0


def test_a_filter_that_keeps_refusing_starts_again_from_it() -> None:
    rig = Rig()
    rig.run(4, 500.0)
    assert abs(rig.north()) < 1.0
    rig.run(3, 500.0)
    assert abs(rig.north() - 500.0) < 1.0
    assert [n.text for n in rig.notices if isinstance(n, Notice)] == ["visloc: restarted from trusted GNSS"]


def test_comparison_needs_velocity_and_gnss() -> None:
    rig = Rig()
    for k in range(20):
        rig.run(1, 40.0 if k >= 10 else 0.0)
        rig.aiding.compare(fix(rig.t, 0.0))
        if k == 15:
            assert rig.monitor.verdict.verdict is Verdict.SUSPECT
    rig.aiding.compare(fix(rig.t + 60, 0.0))
    rig.tracker.forget_velocity()
    rig.aiding.compare(fix(rig.t, 0.0))
    assert rig.monitor.verdict.reasons == ("vision_disagrees", "out_of_reach")


def test_odometry_is_held_against_the_receiver_once_its_position_is_there() -> None:
    rig = Rig()
    for drag in (0.0, 2.0):
        for k in range(30):
            start = round(rig.t * S)
            rig.aiding.on_motion(Motion(start + S, start, (-drag, 0.0), ((0.01, 0.0), (0.0, 0.01))))
            rig.run(1, 0.0)
            if k == 20:
                assert rig.monitor.trusted is (drag == 0.0)
    assert rig.monitor.verdict.reasons == ("odometry_disagrees",)


def test_odometry_across_a_lost_fix_is_not_compared() -> None:
    rig = Rig()
    start = round(rig.t * S)
    rig.t += 1.0
    now = round(rig.t * S)
    rig.aiding.on_gnss(Gnss(now, now, 1, 3, at(0.0), 1.0, None, None), now, Mode.SHADOW)
    rig.aiding.on_motion(Motion(now, start, (900.0, 0.0), ((0.01, 0.0), (0.0, 0.01))))
    rig.run(3, 0.0)
    assert rig.monitor.trusted


def test_fixes_over_one_ground_are_one_witness() -> None:
    """Of two minutes, all 14 m beside from the first on: GNSS was called false after 6 s."""
    rig = Rig()
    for _ in range(200):
        rig.run(0.6, 0.0)
        seen = fix(rig.t, -14.0)
        rig.tracker.observe(seen)
        rig.aiding.compare(seen)
    assert rig.monitor.trusted


def test_what_fixes_have_in_common_may_grow_between_the_filters_state_and_the_comparison() -> None:
    """A lens that comes into doubt by a fix: the variance of how far that one lay from the filter came out below nothing."""
    rig = Rig()
    for k in range(4):
        rig.run(1, 0.0)
        seen = fix(rig.t, 0.0)
        held = rig.tracker.at(seen.t_ns)
        rig.tracker.observe(seen)
        if k == 2:
            rig.tracker.know_map(20.0)
        rig.aiding.compare(seen, held)
    assert rig.monitor.trusted


def test_the_claim_reckons_with_a_map_that_gnss_never_agreed_with() -> None:
    rig = Rig()
    rig.tracker.seed(round(rig.t * S), at(-30.0), 2.0)  # fixes over several grounds that agree among themselves
    rig.aiding.placed()
    for _ in range(20):
        rig.run(0.6, 0.0, mode=Mode.AIDING)
        seen = fix(rig.t, -30.0)
        held = rig.tracker.at(seen.t_ns)
        rig.tracker.observe(seen)
        rig.notices += rig.aiding.compare(seen, held)
    assert rig.monitor.verdict.verdict is Verdict.SUSPECT
    assert [n.text for n in rig.notices if isinstance(n, Notice)] == ["visloc: map is 30 m off GNSS"]
    state = rig.tracker.at(round(rig.t * S))
    assert state is not None
    assert state.cov_ne_m2[0][0] ** 0.5 > 14.0


@pytest.mark.parametrize(("claim_m", "told"), [(1.0, ["visloc: map is 10 m off GNSS"]), (9.0, [])])
def test_what_fixes_claim_themselves_is_laid_to_no_map(claim_m: float, told: list[str]) -> None:
    rig = Rig()
    rig.tracker.seed(round(rig.t * S), at(10.0), 2.0)
    for _ in range(8):
        rig.run(0.6, 0.0, mode=Mode.AIDING)
        seen = fix(rig.t, 10.0, claim_m)
        held = rig.tracker.at(seen.t_ns)
        rig.tracker.observe(seen)
        rig.notices += rig.aiding.compare(seen, held)
    assert [n.text for n in rig.notices if isinstance(n, Notice)] == told
    assert (rig.tracker.shared_m > CoreSettings().navigator.map_sigma_m) == bool(told)
