"""How many threads the numerical libraries have in a command."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

COUNT = "import os, visloc_companion.cli.main, visloc_companion.evaluate.closed_loop; print(len(os.listdir('/proc/self/task')))"


def threads(asked: str | None) -> int:
    """Of a process that has imported a command and what flies in it, under OPENBLAS_NUM_THREADS."""
    environment = {key: value for key, value in os.environ.items() if key != "OPENBLAS_NUM_THREADS"}
    if asked is not None:
        environment["OPENBLAS_NUM_THREADS"] = asked
    done = subprocess.run([sys.executable, "-c", COUNT], env=environment, capture_output=True, text=True, check=True)
    return int(done.stdout)


def test_a_command_has_no_threads_for_matrices_but_those_that_are_asked_for() -> None:
    if len(os.sched_getaffinity(0)) == 1:
        pytest.skip("one core: there are no threads to leave out")
    assert threads(None) == 1
    assert threads("2") > 1
