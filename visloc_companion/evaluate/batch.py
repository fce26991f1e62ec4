"""Many cases by several processes, in order, whatever becomes of the processes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import TypeVar

import cv2

Item = TypeVar("Item")
Result = TypeVar("Result")


def run_all(
    items: Sequence[Item],
    here: Callable[[Item], Result],
    there: Callable[[Item], Result],
    jobs: int,
    at_once: int = 1,
) -> Iterator[Result]:
    """Results in the order of the items, by so many processes; where one of them is killed, this process does the rest.

    `here` is what this process does with an item; `there`, which travels by pickle, what the others do, `at_once` items a time.
    OpenCV has one thread in each of them.
    """
    if jobs <= 1:
        cv2.setNumThreads(1)
        yield from map(here, items)
        return
    done = 0
    try:
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=cv2.setNumThreads, initargs=(1,)) as pool:
            for result in pool.map(there, items, chunksize=at_once):
                done += 1
                yield result
    except BrokenProcessPool:
        yield from run_all(items[done:], here, there, 1)
