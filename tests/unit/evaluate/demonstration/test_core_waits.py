"""How long processes wait for a core, as Linux counts it."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from visloc_companion.evaluate.demonstration.core_waits import CoreWaits, WaitsOf, load_waits

pytestmark = pytest.mark.skipif(not Path("/proc/self/schedstat").is_file(), reason="the kernel does not count it")
SPIN = "import os, time\nos.sched_setaffinity(0, {%d})\nend = time.monotonic() + 30\nwhile time.monotonic() < end: pass"
CHILD = "import subprocess, sys\nsubprocess.run([sys.executable, '-c', %r])"


def looked_at(*codes: str, until: Callable[[CoreWaits], bool]) -> CoreWaits:
    """What is found of processes, the first of them the daemon, looked at five times a second until it shows (30 s at most)."""
    running = [subprocess.Popen([sys.executable, "-c", code], start_new_session=True) for code in codes]
    try:
        waits = WaitsOf(*(process.pid for process in running))
        end = time.monotonic() + 30
        while time.monotonic() < end:
            time.sleep(0.2)
            waits.look()
            found = waits.found(2.0)
            if found is not None and until(found):
                return found
        raise AssertionError(found)
    finally:
        for process in running:
            os.killpg(process.pid, 9)
            process.wait()


def test_four_that_share_a_core_wait_longer_than_they_compute() -> None:
    core = min(os.sched_getaffinity(0))
    found = looked_at(*[SPIN % core] * 4, until=lambda waits: waits.computed_s > 0.5 and waits.longest_s > 0.1)
    assert found.waited_s > found.computed_s
    assert found.busy


def test_who_sleeps_waits_for_no_core() -> None:
    sleeper = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    try:
        waits = WaitsOf(sleeper.pid)
        time.sleep(3.0)  # started
        waits.look()
        time.sleep(0.5)
        waits.look()
        found = waits.found(2.0)
    finally:
        sleeper.kill()
        sleeper.wait()
    assert found is not None and not found.busy
    assert (found.computed_s, found.longest_s) == (0.0, 0.0)


def test_children_count_with_their_parents() -> None:
    core = min(os.sched_getaffinity(0))
    found = looked_at(CHILD % (SPIN % core), until=lambda waits: waits.computed_s > 0.5)
    assert found.computed_s > 0.5


def test_of_none_that_ever_was_nothing_is_found(tmp_path: Path) -> None:
    ended = subprocess.Popen([sys.executable, "-c", "pass"])
    ended.wait()
    waits = WaitsOf(ended.pid)
    waits.look()
    assert waits.found(2.0) is None
    assert load_waits(tmp_path / "computer.json") is None


def test_what_is_saved_is_read_again(tmp_path: Path) -> None:
    found = CoreWaits(132.0, 20.0, 0.012, 2.0)
    found.save(tmp_path / "computer.json")
    assert load_waits(tmp_path / "computer.json") == found
