"""The processor is given back while simulated time waits."""

from __future__ import annotations

import os
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from visloc_companion.sim.real.priority import go_first, in_turn
from visloc_companion.sim.real.programs import running


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


def allowed() -> int:
    """The policy of a process that asked to go first, and without the flag about children."""
    go_first()
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK


def test_a_simulator_goes_first_where_the_daemon_does(tmp_path: Path) -> None:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        expected = pool.submit(allowed).result()
    with running([sys.executable, "-c", "import time; time.sleep(60)"], tmp_path, {}) as simulator:
        assert os.sched_getscheduler(simulator.pid) == expected
