from __future__ import annotations

from visloc_companion.core.guard import RESTART_AFTER, Complaints, TimeCheck, TimeGuard
from visloc_companion.errors import Reason
from visloc_companion.types import Tick

S = 1_000_000_000


def test_small_steps_back_are_clamped() -> None:
    guard = TimeGuard()
    assert guard.check(10 * S) is TimeCheck.FINE
    assert guard.check(10 * S - S // 2) is TimeCheck.FINE
    assert guard.now_ns == 10 * S


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
