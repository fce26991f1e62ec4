"""The ring of the last minutes."""

from __future__ import annotations

from typing import Any

from tests.unit.web.snapshots import snapshot
from visloc_companion.web.heard import Heard
from visloc_companion.web.history import History
from visloc_companion.web.view import Origin, view_of


def view_at(t_s: float, *, age_s: float = 0.0) -> dict[str, Any]:
    return view_of(Heard(snapshot(t_s), t_s), Origin("s"), t_s + age_s)


def test_it_is_bounded_however_long_the_flight() -> None:
    history = History(kept=50)
    for k in range(1000):
        history.take(view_at(k))
    kept = history.samples()
    assert len(kept) == 50
    assert kept[-1] is not None
    assert kept[-1][0] == 500.0 + 999


def test_it_takes_two_a_second_at_most() -> None:
    history = History()
    taken = [history.take(view_at(k / 10)) for k in range(11)]
    assert [k for k, sample in enumerate(taken) if sample is not None] == [0, 5, 10]
    assert taken[0] == (500.0, 47.4, 8.55, "aiding", taken[0][4], 12.0, 40.0)  # type: ignore[index]


def test_a_silence_is_one_gap_and_no_line_across_it() -> None:
    history = History()
    history.take(view_at(0.0))
    for age_s in (3.0, 4.0, 5.0):
        assert history.take(view_at(0.0, age_s=age_s)) is None
    history.take(view_at(9.0))
    assert [sample if sample is None else sample[0] for sample in history.samples()] == [500.0, None, 509.0]


def test_time_that_goes_back_begins_it_anew() -> None:
    history = History()
    for t_s in (0.0, 1.0, 2.0):
        history.take(view_at(t_s))
    assert history.began == 0
    history.take(view_at(-400.0))
    assert history.began == 1
    assert len(history.samples()) == 1
