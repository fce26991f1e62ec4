"""What a command loads, and how many threads the numerical libraries have in it."""

from __future__ import annotations

import functools
import os
import subprocess
import sys

import pytest

COMMANDS = "visloc_companion.cli.main, visloc_companion.evaluate.campaign, visloc_companion.evaluate.flight"
AGAIN = "visloc_companion.app.replay, visloc_companion.app.rerun"
LOADS = f"""import os, sys, {COMMANDS}, {AGAIN}
print(int("filterpy" in sys.modules))
import visloc_companion.core.navigator
print(len(os.listdir("/proc/self/task")))"""


@functools.cache
def loaded(asked: str | None) -> tuple[bool, int]:
    """Of a process that has imported commands: whether filterpy came with them, and its threads with what flies in them, under
    OPENBLAS_NUM_THREADS."""
    environment = {key: value for key, value in os.environ.items() if key != "OPENBLAS_NUM_THREADS"}
    if asked is not None:
        environment["OPENBLAS_NUM_THREADS"] = asked
    done = subprocess.run([sys.executable, "-c", LOADS], env=environment, capture_output=True, text=True, check=True)
    filterpy, threads = map(int, done.stdout.split())
    return bool(filterpy), threads


def test_a_command_that_flies_nothing_waits_for_nothing_that_flies() -> None:
    """`visloc sim --list` and every command line that was refused loaded filterpy first, as long as all else together."""
    assert not loaded(None)[0]


def test_a_command_has_no_threads_for_matrices_but_those_that_are_asked_for() -> None:
    if len(os.sched_getaffinity(0)) == 1:
        pytest.skip("one core: there are no threads to leave out")
    assert loaded(None)[1] == 1
    assert loaded("2")[1] > 1
