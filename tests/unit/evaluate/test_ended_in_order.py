"""Work that is done aside, and ends when its listener does."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType

import pytest

from visloc_companion.evaluate.ended_in_order import aside, done_until_broken_off, ended_in_order


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
            threading.Timer(0.1, os.kill, [os.getpid(), signal.SIGTERM]).start()  # raise_signal would wake the timer's thread
    assert told.is_set()
    assert not [thread for thread in threading.enumerate() if thread.name == "aside"]


def quick(ready: threading.Event, told: threading.Event) -> Iterator[int]:
    """Five results at once, and none until told to end."""
    yield from range(5)
    ready.set()
    told.wait(30)


def test_what_was_ready_when_the_listener_was_told_to_end_is_taken() -> None:
    ready, told, taken = threading.Event(), threading.Event(), list[int]()

    def on_each() -> None:
        ready.wait(30)
        raise KeyboardInterrupt

    why = done_until_broken_off(aside(lambda: quick(ready, told), told.set), taken, on_each)
    assert isinstance(why, KeyboardInterrupt)
    assert taken == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("at", range(24))
def test_no_result_is_lost_or_taken_twice_wherever_a_signal_raises(at: int) -> None:
    """As a handler does, at one line after the other of whoever waits."""
    ready, told, taken, lines = threading.Event(), threading.Event(), list[int](), iter(range(1000))

    def raising(frame: FrameType, event: str, _: object) -> object:
        if frame.f_code is not aside.__code__:
            return None
        if event == "line" and next(lines) == at:
            sys.settrace(None)
            raise KeyboardInterrupt
        return raising

    results = aside(lambda: quick(ready, told), told.set)
    threading.Timer(0.2, told.set).start()
    sys.settrace(raising)
    try:
        done_until_broken_off(results, taken, lambda: ready.wait(30))
    except KeyboardInterrupt:
        assert taken == []
    finally:
        sys.settrace(None)
    assert taken in ([], [0, 1, 2, 3, 4])
