"""Many cases by several processes, in order, whatever becomes of the processes."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from functools import partial
from multiprocessing import get_context
from multiprocessing.synchronize import Event
from typing import TypeVar

import cv2

from visloc_companion.app.with_parent import end_with_parent
from visloc_companion.evaluate.ended_in_order import aside

Item = TypeVar("Item")
Result = TypeVar("Result")
_broken_off: list[Event] = []
"""In a process of `run_all`: whether nobody waits for its results any more; empty in others."""


def run_all(
    items: Sequence[Item],
    here: Callable[[Item], Result],
    there: Callable[[Item], Result],
    jobs: int,
    at_once: int = 1,
) -> Iterator[Result]:
    """Results in the order of the items, by so many processes; where one of them is killed, this process does the rest.

    `here` is what this process does with an item; `there`, which travels by pickle, what the others do, `at_once` items a time.
    OpenCV has one thread in each of them. Broken off (Ctrl-C, which is this process' to hear, or an iterator that is closed),
    they end with the item that they are at; where this process is killed, at once.
    """
    if jobs <= 1:
        cv2.setNumThreads(1)
        yield from map(here, items)
        return
    done, context = 0, get_context("spawn")
    broken_off = context.Event()

    def by_others() -> Iterator[Result]:
        nonlocal done
        with ProcessPoolExecutor(jobs, mp_context=context, initializer=_began, initargs=(broken_off,)) as pool:
            for result in pool.map(partial(_unless_broken_off, there), items, chunksize=at_once):
                done += 1
                yield result

    try:
        with closing(aside(by_others, broken_off.set)) as results:
            yield from results
    except BrokenProcessPool:
        yield from run_all(items[done:], here, there, 1)


def _began(broken_off: Event) -> None:
    """First thing in a process of `run_all`."""
    end_with_parent()
    _broken_off.append(broken_off)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)


def _unless_broken_off(there: Callable[[Item], Result], item: Item) -> Result:
    if any(event.is_set() for event in _broken_off):
        raise InterruptedError("nobody waits for this result")
    return there(item)
