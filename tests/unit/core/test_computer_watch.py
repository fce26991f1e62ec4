"""What the operator reads of a computer that contradicts itself."""

from __future__ import annotations

from visloc_companion.core.computer_watch import ComputerWatch
from visloc_companion.core.navigator import Navigator
from visloc_companion.core.settings import CoreSettings
from visloc_companion.errors import Reason
from visloc_companion.types import Fix, GeoPoint, NoFix, Notice, Severity

COV = ((1.0, 0.0), (0.0, 1.0))


def no_fix(reason: Reason) -> NoFix:
    return NoFix(0, 0, 1, 1, "deep", reason, 100.0, "3 m apart")


FIX = Fix(0, 0, 1, 1, "deep", GeoPoint(47.0, 8.0, 600.0), (1.0, 0.0, 0.0, 0.0), COV, 1.0, 0.01, 1e-3, 100.0)


def test_one_difference_is_logged_and_the_end_of_fixes_is_told_once() -> None:
    watch = ComputerWatch()
    assert watch.on_answer(FIX) == watch.on_answer(no_fix(Reason.NO_MATCH)) == []
    (logged,) = watch.on_answer(no_fix(Reason.COMPUTATION_DIFFERS))
    assert isinstance(logged, Notice)
    assert not logged.to_operator
    assert ("detail", "3 m apart") in logged.data
    (told,) = watch.on_answer(no_fix(Reason.SWITCHED_OFF))
    assert isinstance(told, Notice)
    assert (told.to_operator, told.severity) == (True, Severity.CRITICAL)
    assert len(told.text) <= 50
    assert watch.on_answer(no_fix(Reason.SWITCHED_OFF)) == []
    (back,) = watch.on_answer(FIX)
    assert isinstance(back, Notice)
    assert back.to_operator
    assert watch.on_answer(FIX) == []


def test_the_navigator_passes_it_on() -> None:
    commands = Navigator(CoreSettings()).on(no_fix(Reason.SWITCHED_OFF), 0)
    assert [c.text for c in commands if isinstance(c, Notice) and c.to_operator] == ["visloc: COMPUTER FAULTY, no camera fixes"]
