"""Work that is done aside, and ends when its listener does."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator

import pytest

from visloc_companion.evaluate.ended_in_order import aside, ended_in_order


def counting(told: threading.Event) -> Iterator[int]:
    """0, and 1 once told to end."""
    yield 0
    told.wait(30)
    yield 1


def test_results_come_in_order_from_another_thread() -> None:
    told = threading.Event()

    def work() -> Iterator[tuple[int, int]]:
        for k in range(3):
            yield k, threading.get_ident()

    results = list(aside(work, told.set))
    assert [k for k, _ in results] == [0, 1, 2]
    assert all(thread != threading.get_ident() for _, thread in results)
    assert told.is_set()


def test_what_the_work_raises_is_raised_after_its_results() -> None:
    def work() -> Iterator[int]:
        yield 7
        raise ValueError("no eighth")

    results = aside(work, lambda: None)
    assert next(results) == 7
    with pytest.raises(ValueError, match="no eighth"):
        next(results)


def test_who_closes_it_stops_the_work_and_waits_for_its_end() -> None:
    told = threading.Event()
    results = aside(lambda: counting(told), told.set)
    assert next(results) == 0
    results.close()
    assert told.is_set()
    assert not [thread for thread in threading.enumerate() if thread.name == "aside"]


def test_a_signal_ends_the_wait_not_the_work() -> None:
    told = threading.Event()
    with ended_in_order(), pytest.raises(SystemExit, match="143"):
        for result in aside(lambda: counting(told), told.set):
            assert result == 0
            threading.Timer(0.1, signal.raise_signal, [signal.SIGTERM]).start()
    assert told.is_set()
    assert not [thread for thread in threading.enumerate() if thread.name == "aside"]
