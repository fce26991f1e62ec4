"""Processes that work for another one end with it, though it was killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NoReturn

import pytest

from tests.unit.processes import is_alive
from visloc_companion.app.with_parent import end_with_parent
from visloc_companion.evaluate import campaign
from visloc_companion.evaluate.batch import run_all
from visloc_companion.evaluate.campaign import FlightSpec, fly_campaign
from visloc_companion.sim.real import apart
from visloc_companion.sim.real.programs import Simulator, running
from visloc_companion.sim.real.scenarios import real_scenario

PATIENCE_S = 90.0
WITHIN_S = 20.0


def work(_: object, folder: Path) -> NoReturn:
    """Goes on until somebody ends it."""
    (folder / str(os.getpid())).touch()
    while True:
        time.sleep(0.1)


def do_all(folder: Path) -> None:
    endless = partial(work, folder=folder)
    list(run_all([0, 1], endless, endless, 2))


def fly_all(folder: Path) -> None:
    list(fly_campaign([FlightSpec("jam", folder, None, None, seed=seed) for seed in (1, 2)], 2))


async def beside_a_simulator(*_: object, folder: Path) -> NoReturn:
    """The program of an autopilot leads a session of its own."""
    with running(["sleep", "600"], folder.parent, {}) as simulator:
        (folder / str(simulator.pid)).touch()
        work(None, folder)


def fly_beside_a_simulator(_: Path) -> None:
    os.environ["VISLOC_ARDUCOPTER"] = "sleep"
    apart.fly_apart(Simulator.ARDUCOPTER, real_scenario("jam", Simulator.ARDUCOPTER))


def as_main(what: str, folder: Path) -> None:
    """In the process that is killed, and in those that it starts, which import its script anew."""
    campaign.fly_spec = partial(work, folder=folder)  # type: ignore[assignment]
    apart.fly = partial(beside_a_simulator, folder=folder)
    apart.enter_own_network = lambda: None
    if what:
        {"do_all": do_all, "fly_all": fly_all, "fly_beside_a_simulator": fly_beside_a_simulator}[what](folder)


def within(limit_s: float, what: Callable[[], bool]) -> bool:
    end = time.monotonic() + limit_s
    while not what():
        if time.monotonic() > end:
            return False
        time.sleep(0.05)
    return True


@pytest.mark.parametrize("what", ["do_all", "fly_all", "fly_beside_a_simulator"])
def test_those_of_a_killed_process_end(tmp_path: Path, what: str) -> None:
    script, folder = tmp_path / "script.py", tmp_path / "pids"
    folder.mkdir()
    script.write_text(
        f"import pathlib, sys\nsys.path.insert(0, {str(Path(__file__).parent)!r})\nimport test_with_parent\n"
        f"test_with_parent.as_main({what!r} if __name__ == '__main__' else '', pathlib.Path({str(folder)!r}))\n",
        encoding="utf-8",
    )
    parent = subprocess.Popen([sys.executable, str(script)])
    try:
        assert within(PATIENCE_S, lambda: len(list(folder.iterdir())) == 2)
    finally:
        parent.kill()
        parent.wait()
    pids = [int(file.name) for file in folder.iterdir()]
    try:
        assert within(WITHIN_S, lambda: not any(map(is_alive, pids)))
    finally:
        for pid in filter(is_alive, pids):
            os.kill(pid, signal.SIGKILL)


def test_a_process_that_nobody_waits_for_goes_on() -> None:
    end_with_parent()
    assert is_alive(os.getpid())
