"""The processor is given back while simulated time waits."""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from visloc_companion.sim.real.priority import go_first, in_turn


def policies() -> tuple[int, int, int]:
    """In a process of its own: first, in its turn, first again (without the flag about children)."""
    go_first()
    before = os.sched_getscheduler(0)
    with in_turn():
        meanwhile = os.sched_getscheduler(0)
    return before, meanwhile, os.sched_getscheduler(0)


def test_long_work_waits_its_turn_and_then_it_goes_first_again() -> None:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        before, meanwhile, after = pool.submit(policies).result()
    assert meanwhile == os.SCHED_OTHER
    assert before == after  # where nobody may go first all three are the same
