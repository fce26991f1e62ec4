"""Batches made ahead of the step that learns from them: in a thread, or in processes where one thread is too slow for a GPU."""

from __future__ import annotations

import os
import signal
import warnings
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import fields
from itertools import islice
from multiprocessing import get_context
from typing import TypeVar

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from visloc_companion.app.with_parent import end_with_parent
from visloc_companion.errors import ConfigError
from visloc_companion.train.steps import Batch

Make = Callable[[int], Batch]
Arrays = tuple[NDArray[np.float32], ...]
T = TypeVar("T")
EACH_AHEAD = 2
"""Batches that are asked for at a time, for each process."""
_here: list[Make] = []
"""What makes the batches, in a process that does nothing else."""


def batches_ahead(make: Make, start: int, stop: int, workers: int = 0) -> Iterator[tuple[int, Batch]]:
    """(step, batch) in order from `start` up to `stop`, the same with any number of processes; 0: a thread.

    No more processes than cores are started. Raises ConfigError where one of them dies (memory).
    """
    if workers == 0:
        with ThreadPoolExecutor(1, "pairs") as thread:
            yield from _in_order(thread, make, start, stop, 1)
        return
    workers = min(workers, len(os.sched_getaffinity(0)))
    pool = ProcessPoolExecutor(workers, get_context("fork"), _begin, (make,))
    try:
        _start(pool)
        for step, arrays in _in_order(pool, _made, start, stop, EACH_AHEAD * workers):
            yield step, Batch(*map(torch.from_numpy, arrays))
    except BrokenProcessPool as why:
        raise ConfigError(
            "a process that makes pairs was ended from outside",
            where="--workers",
            remedy="fewer of them, or more memory; the same command goes on from the last checkpoint",
        ) from why
    finally:
        pool.shutdown(cancel_futures=True)


def _start(pool: Executor) -> None:
    """Fork the processes, so that the images of all sources stay in memory once. They use nothing that threads of this one hold,
    as the warning of Python 3.12 and later fears: no GPU, and one thread each."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        pool.submit(int).result()


def _in_order(pool: Executor, make: Callable[[int], T], start: int, stop: int, ahead: int) -> Iterator[tuple[int, T]]:
    asked = iter(range(start, stop))
    pending = deque[Future[T]](pool.submit(make, step) for step in islice(asked, ahead))
    for step in range(start, stop):
        made = pending.popleft().result()
        pending.extend(pool.submit(make, later) for later in islice(asked, 1))
        yield step, made


def _begin(make: Make) -> None:
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    _here[:] = [make]


def _made(step: int) -> Arrays:
    batch = _here[0](step)
    return tuple(getattr(batch, field.name).numpy() for field in fields(batch))
