from __future__ import annotations

from dataclasses import replace

import pytest

from visloc_companion.core.guard import RESTART_AFTER, STEP_NS, Complaints, TimeCheck, TimeGuard
from visloc_companion.core.validate import fault
from visloc_companion.errors import Reason
from visloc_companion.types import Fix, GeoPoint, OriginChanged, PriorPose, Tick

S = 1_000_000_000


def test_small_steps_back_are_clamped() -> None:
    guard = TimeGuard()
    assert guard.check(10 * S) is TimeCheck.FINE
    assert guard.check(10 * S - STEP_NS) is TimeCheck.FINE
    assert guard.check(10 * S - S // 2) is TimeCheck.BEHIND
    assert guard.now_ns == 10 * S
    assert guard.check(10 * S) is TimeCheck.FINE
    assert guard.stood_ns() == 0  # one event alone was overtaken


def test_a_clock_that_steps_back_stands_until_it_has_caught_up() -> None:
    guard = TimeGuard()
    guard.check(10 * S)
    checks = [guard.check(10 * S + (k - 8) * S // 10) for k in range(8)]
    assert checks == [TimeCheck.BEHIND] * 8
    assert guard.check(10 * S + 1) is TimeCheck.FINE
    assert (guard.stood_ns(), guard.stood_ns()) == (8 * S // 10, 0)


def test_one_event_of_the_past_is_dropped_and_many_restart() -> None:
    guard = TimeGuard()
    guard.check(100 * S)
    assert guard.check(5 * S) is TimeCheck.DROP
    assert guard.check(101 * S) is TimeCheck.FINE
    checks = [guard.check(5 * S + k) for k in range(RESTART_AFTER)]
    assert checks == [TimeCheck.DROP] * (RESTART_AFTER - 1) + [TimeCheck.RESTART]


def test_the_same_complaint_is_made_once_in_ten_seconds() -> None:
    complaints = Complaints()
    assert [n.text for n in complaints.about(Tick(0), Reason.NOT_FINITE, 0)] == ["Tick not used: not_finite"]
    assert complaints.about(Tick(0), Reason.NOT_FINITE, 9 * S) == []
    assert len(complaints.about(Tick(0), Reason.GATED, 9 * S)) == 1
    assert len(complaints.about(Tick(0), Reason.NOT_FINITE, 10 * S)) == 1


@pytest.mark.parametrize(
    ("var_n_m2", "sigma_h_m", "claimed"), [(0.0, 1.0, "0.00"), (0.5, 1e-9, "0.00"), (4e10, 1.0, "2e+05"), (0.5, 1e6, "1e+06")]
)
def test_the_operator_hears_which_localiser_claims_what_cannot_be(var_n_m2: float, sigma_h_m: float, claimed: str) -> None:
    place, level, cov_m2 = GeoPoint(47.0, 8.0, 500.0), (1.0, 0.0, 0.0, 0.0), ((var_n_m2, 0.0), (0.0, 0.5))
    fix = Fix(0, 0, 1, 1, "a_long_name_of_mine", place, level, cov_m2, sigma_h_m, 0.01, 1e-4, 5.0)
    (notice,) = Complaints().about(fix, Reason.IMPLAUSIBLE_CLAIM, 0)
    assert (notice.text, notice.to_operator) == (f"visloc: a_long_name_ claims {claimed} m, FIXES REFUSED", True)
    assert len(notice.text) <= 50


def test_the_operator_hears_that_there_is_no_position_at_the_poles() -> None:
    """Once, for origin and position alike."""
    place, complaints = GeoPoint(89.5, 10.0, 80.0), Complaints()
    events = OriginChanged(0, place), PriorPose(0, 0, place, (0.0, 0.0, 0.0), 80.0)
    assert [fault(event, 0) for event in events] == [Reason.AT_A_POLE] * 2
    (notice,) = [notice for event in events for notice in complaints.about(event, Reason.AT_A_POLE, 0)]
    assert (notice.text, notice.to_operator) == ("visloc: beyond 89 deg of latitude, NO POSITION", True)
    assert fault(replace(events[0], origin=replace(place, lat_deg=90.1)), 0) is Reason.NOT_FINITE
    assert fault(replace(events[0], origin=replace(place, lat_deg=-89.0)), 0) is None


@pytest.mark.parametrize(
    ("step_s", "asked_s", "since_s"),
    [(1.5, 12.6, 11.0), (1.5, 17.0, 11.0), (1.5, 18.0, None), (0.6, 12.6, None), (2.0, 12.6, None)],
)
def test_a_gap_as_long_as_the_step_tells_whose_clock_leapt(step_s: float, asked_s: float, since_s: float | None) -> None:
    guard = TimeGuard()
    for k in range(11):
        guard.check(10 * S + k * S // 10)
    for k in range(round((asked_s - 12.6) * 10) + 1):
        guard.check(126 * S // 10 + k * S // 10)
    assert guard.leapt_since_ns(round(step_s * S)) == (None if since_s is None else round(since_s * S))
