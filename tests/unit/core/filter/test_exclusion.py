"""Fixes that odometry contradicts are left out, and an inertial velocity that two intervals contradict is given up."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.core.estimator import PositionFilter
from visloc_companion.core.filter import exclusion, fusion, separation
from visloc_companion.core.filter.belief import Belief, seeded
from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.motion import MEAN_VELOCITY, Motion, learned
from visloc_companion.core.filter.propagation import POSITION, VELOCITY, Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.geo import wgs84
from visloc_companion.types import Accepted, Fix, GeoPoint, Rejected

S = 1_000_000_000
SETTINGS = NavigatorSettings()
ORIGIN = GeoPoint(59.3, 18.1, 40.0)
SPEED_MPS, EVERY_S, SIGMA_A = 8.0, 0.25, 0.25
LAST_GOOD_S, END_S, ASTRAY_M = 20.75, 23.0, 2.0
H = MEAN_VELOCITY


def fix(t_s: float, off_m: float, sigma_m: float, claimed: float) -> Fix:
    place = wgs84.geo_from_ned((SPEED_MPS * t_s + off_m, 0.0, -100.0), ORIGIN)
    cov = ((sigma_m**2, 0.0), (0.0, sigma_m**2))
    t_ns, k = round(t_s * S), round(t_s / EVERY_S)
    return Fix(t_ns, t_ns, k, k, "deep", place, (1.0, 0.0, 0.0, 0.0), cov, 2.0, 0.1, claimed, 5.0)


def motion(t_s: float, span_s: float = 2.0, false_mps: float = 0.0) -> Motion:
    d = ((SPEED_MPS + false_mps) * span_s, 0.0)
    return Motion(round(t_s * S), round((t_s - span_s) * S), d, ((0.02, 0.0), (0.0, 0.02)))


def flown(wrong_m: float, until_s: float = END_S, wrong_from_s: float = LAST_GOOD_S) -> PositionFilter:
    """North at SPEED_MPS on good fixes and odometry, but for fixes that go astray from `wrong_from_s` on, by `wrong_m` a fix."""
    drive = Velocity(0, (SPEED_MPS, 0.0, 0.0), 140.0, 0.8, Drive.INERTIAL, SIGMA_A)
    start = seeded(0, (0.0, 0.0), 1.0, 0.8, Drive.INERTIAL, SETTINGS)
    the_filter, n_wrong = PositionFilter(SETTINGS, ORIGIN, start, drive), 0
    for k in range(1, round(until_s / EVERY_S) + 1):
        t = k * EVERY_S
        the_filter.drive(replace(drive, t_ns=round(t * S)))
        if t <= wrong_from_s:
            the_filter.observe(fix(t, 0.0, 0.6, 1e-4))
        elif k % 2:
            n_wrong += 1
            the_filter.observe(fix(t, wrong_m * n_wrong, 1.0, 0.03))
        if k % 8 == 0 and t <= wrong_from_s:
            assert isinstance(the_filter.observe_motion(motion(t)), Accepted)
    return the_filter


def off_m(the_filter: PositionFilter, t_s: float) -> float:
    return abs(the_filter.at(round(t_s * S)).p_ned_m[0] - SPEED_MPS * t_s)


def test_fixes_that_odometry_contradicts_are_left_out() -> None:
    the_filter = flown(ASTRAY_M)
    assert off_m(the_filter, END_S) > 2.0, "the wrong fixes were followed"
    assert isinstance(the_filter.observe_motion(motion(END_S)), Accepted)
    belief = the_filter.newest
    assert off_m(the_filter, END_S) < 3 * math.sqrt(belief.P[0, 0])
    assert off_m(the_filter, END_S) < 0.8
    assert abs(belief.x[VELOCITY.start]) < 0.4
    assert belief.rested_ns <= round((LAST_GOOD_S + 0.5) * S), (
        "it rests on the last good fix, or on the first and least wrong one"
    )


def test_without_exclusion_the_filter_stays_astray(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("visloc_companion.core.filter.motion.excluding", lambda *_: None)
    the_filter = flown(ASTRAY_M)
    the_filter.observe_motion(motion(END_S))
    assert off_m(the_filter, END_S) > 2.0


def test_what_the_filter_said_before_stays_possible() -> None:
    the_filter = flown(ASTRAY_M)
    said_m = the_filter.newest.x[POSITION].copy()
    the_filter.observe_motion(motion(END_S))
    belief = the_filter.newest
    apart = np.hypot(*(belief.without.x[:, POSITION] - said_m).T)
    assert belief.without.leaves[-1] == separation.ONE
    assert belief.without.probability[-1] >= separation.CLAIM_FLOOR
    assert (belief.without.rested_ns[:-1] <= belief.rested_ns).all(), "no other rests on what was left out"
    assert apart[-1] < 3.0, "odometry has moved it, too"
    assert the_filter.protection_level_m(belief.t_ns) > float(np.hypot(*(said_m - belief.x[POSITION])))


def test_a_deceived_interval_leaves_no_good_fix_out() -> None:
    the_filter = flown(0.0)
    before = the_filter.newest
    assert isinstance(the_filter.observe_motion(motion(END_S, false_mps=8.0)), Rejected)
    assert the_filter.newest.rested_ns == before.rested_ns
    np.testing.assert_array_equal(the_filter.newest.P, before.P)


def test_an_interval_that_agrees_leaves_nothing_out() -> None:
    belief = flown(0.0).newest
    assert exclusion.excluding(belief, H @ belief.x, 0.04 * np.eye(2), H) is None


def test_without_other_solutions_nothing_is_left_out() -> None:
    belief = flown(ASTRAY_M).newest._replace(without=separation.NONE)
    assert exclusion.excluding(belief, H @ belief.x + 5.0, 0.04 * np.eye(2), H) is None


def astray(false_mps: float = 4.0) -> Belief:
    """Sure of a velocity that is false, and no fix to leave out."""
    belief = seeded(0, (0.0, 0.0), 1.0, 0.3, Drive.INERTIAL, SETTINGS)
    x = belief.x.copy()
    x[VELOCITY.start] = -false_mps
    return belief._replace(x=x, sigma_a_mps2=SIGMA_A)


def gone_on(belief: Belief, t_s: float, seen_mps: float) -> tuple[Belief, Accepted | Rejected]:
    """One and a half seconds later, with what odometry saw."""
    carried = fusion.propagated(belief, round(t_s * S), (SPEED_MPS, 0.0), SETTINGS)
    return learned(carried, motion(t_s, 1.5, seen_mps - SPEED_MPS), (SPEED_MPS * 1.5, 0.0), SETTINGS)


def test_two_intervals_that_say_the_same_are_believed_against_an_inertial_velocity() -> None:
    first, outcome = gone_on(astray(), 1.5, SPEED_MPS)
    assert isinstance(outcome, Rejected)
    second, outcome = gone_on(first, 3.0, SPEED_MPS)
    assert isinstance(outcome, Accepted)
    assert second.doubt is None
    assert abs(second.x[VELOCITY.start]) < 0.5
    error_m = second.x[0] - 3.0 * SPEED_MPS
    assert abs(error_m) < 3 * math.sqrt(second.P[0, 0])
    assert abs(error_m) < 6.0, "the velocity was false by 4 m/s for 3 s; most of that is taken back"


@pytest.mark.parametrize(("later_mps", "believed"), [(1.0, True), (-1.0, True), (9.0, False)])
def test_accelerations_that_were_carried_away_too_may_change_between_two_intervals(later_mps: float, believed: bool) -> None:
    """Of an autopilot whose attitude followed our own error: 1 m/s in 1.5 s, though its accelerations were steady until now."""
    steady = astray()._replace(sigma_a_mps2=0.05)
    first, _ = gone_on(steady, 1.5, SPEED_MPS)
    _, outcome = gone_on(first, 3.0, SPEED_MPS + later_mps)
    assert isinstance(outcome, Accepted) is believed


def test_one_interval_changes_nothing_but_the_doubt() -> None:
    first, _ = gone_on(astray(), 1.5, SPEED_MPS)
    carried = fusion.propagated(astray(), round(1.5 * S), (SPEED_MPS, 0.0), SETTINGS)
    np.testing.assert_array_equal(first.P, carried.P)
    np.testing.assert_array_equal(first.x, carried.x)
    assert first.doubt is not None


def test_what_was_believed_before_ends_the_doubt() -> None:
    deceived, _ = gone_on(astray(0.0), 1.5, SPEED_MPS + 5.0)
    assert deceived.doubt is not None
    after, outcome = gone_on(deceived, 3.0, SPEED_MPS)
    assert isinstance(outcome, Accepted)
    assert after.doubt is None
    assert abs(after.x[VELOCITY.start]) < 0.3


def test_a_frozen_camera_agrees_with_itself_and_is_not_believed() -> None:
    belief = astray(0.0)
    for k in range(1, 5):
        belief, outcome = gone_on(belief, 1.5 * k, 0.0)
        assert isinstance(outcome, Rejected)
    assert abs(belief.x[VELOCITY.start]) < 0.1


def test_a_frozen_camera_is_not_believed_after_a_doubt_of_another_kind() -> None:
    belief, _ = gone_on(astray(0.0), 1.5, SPEED_MPS + 5.0)
    doubt = belief.doubt
    assert doubt is not None
    for k in range(2, 6):
        belief, outcome = gone_on(belief, 1.5 * k, 0.0)
        assert isinstance(outcome, Rejected)
        assert belief.doubt is doubt, "standing pictures take no doubt's place"
    assert abs(belief.x[VELOCITY.start]) < 0.1
