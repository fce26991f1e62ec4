"""Warnings of a replayed flight are told once each, with when."""

from __future__ import annotations

from visloc_companion.app.journal import Entry
from visloc_companion.evaluate.told import Told
from visloc_companion.types import Notice, Severity, Tick

LATE = Notice(Severity.WARNING, "visloc: frame stamps 300 ms late, corrected", to_operator=True)


def entries(*notices: Notice) -> list[Entry]:
    return [Entry(10**9, Tick(10**9), None), *(Entry(k * 10**9, None, notice) for k, notice in enumerate(notices, start=2))]


def test_warnings_are_told_once_with_the_time_of_the_first() -> None:
    told, given = Told(), entries(LATE, Notice(Severity.CRITICAL, "visloc: LOST", to_operator=True), LATE)
    assert list(told.heard(given)) == given
    assert told.sentences(10**9) == [
        "The operator would have been told after 1.0 s: visloc: frame stamps 300 ms late, corrected",
        "The operator would have been told after 2.0 s: visloc: LOST",
    ]


def test_what_is_no_warning_or_not_for_the_operator_is_not() -> None:
    told = Told()
    list(told.heard(entries(Notice(Severity.NOTICE, "a", to_operator=True), Notice(Severity.WARNING, "b"))))
    assert told.sentences(0) == []


def test_of_many_the_number_is_told() -> None:
    told = Told()
    list(told.heard(entries(*(Notice(Severity.WARNING, f"{k} m", to_operator=True) for k in range(15)))))
    assert len(told.sentences(0)) == 13 and told.sentences(0)[-1] == "And 3 more warnings."
