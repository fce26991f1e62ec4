"""Flights that end otherwise than planned: a simulator that falls silent or ends, a process that is killed."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NoReturn

import pytest

from tests.unit.processes import is_alive
from visloc_companion.errors import ConfigError, LinkError, WorkerError
from visloc_companion.sim.real import apart, flight
from visloc_companion.sim.real.apart import fly_apart, make_pilot
from visloc_companion.sim.real.clock import SlavedClock
from visloc_companion.sim.real.lives import DaemonLives
from visloc_companion.sim.real.programs import Simulator, running
from visloc_companion.sim.real.record import RealLog
from visloc_companion.sim.real.recorder import Recorder
from visloc_companion.sim.real.scenarios import real_scenario
from visloc_companion.sim.real.station import Station

SECOND_NS = 1_000_000_000


class Beating(Station):
    """Counts its heartbeats, and lets simulated time pass by one second at each of the first `moving`."""

    def __init__(self, clock: SlavedClock, moving: int) -> None:
        super().__init__("tcpin:127.0.0.1:1", clock, lambda _: None)
        self.beats, self._moving, self._time = 0, moving, clock

    def heartbeat(self) -> None:
        self.beats += 1
        if self.beats <= self._moving:
            self._time.hear(self.beats * SECOND_NS)


async def kept_alive(moving: int, tmp_path: Path, for_s: float) -> Beating:
    clock = SlavedClock()
    station = Beating(clock, moving)
    with running([sys.executable, "-c", "import time; time.sleep(60)"], tmp_path, {}) as simulator:
        await asyncio.wait_for(flight._keep_alive(station, clock, simulator), for_s)
    return station


def test_a_simulator_that_falls_silent_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """What waits for its time would wait for ever."""
    monkeypatch.setattr(flight, "NAPS", 2)
    with pytest.raises(LinkError, match="its time stood still"):
        asyncio.run(kept_alive(30, tmp_path, 30.0))


def test_one_that_has_not_begun_to_tell_its_time_is_waited_for(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(flight, "NAPS", 1)
    with pytest.raises(TimeoutError):
        asyncio.run(kept_alive(0, tmp_path, 2.0))


def test_a_daemon_that_is_down_does_not_come_back_where_time_stands_still(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The simulator ended while the daemon was down: the flight is over, though those 3 s never pass."""

    async def fly() -> None:
        simulator: Any = None
        clock = SlavedClock()
        pilot, scenario = make_pilot(Simulator.PX4), real_scenario("restarts", Simulator.PX4)
        lives, stop = DaemonLives(pilot, scenario, tmp_path, Recorder(pilot, clock, RealLog()), simulator), asyncio.Event()
        monkeypatch.setattr(lives, "_live", lambda _: asyncio.sleep(60))
        run = asyncio.create_task(lives.run(stop))
        await asyncio.sleep(0.05)
        lives.kill()
        await asyncio.sleep(0.05)
        assert not run.done()
        stop.set()
        await asyncio.wait_for(run, 5.0)

    asyncio.run(fly())


def test_a_program_ends_with_the_process_that_started_it(tmp_path: Path) -> None:
    """Killed, that process cannot end what leads a session of its own."""
    code = (
        "import pathlib, sys, time\nfrom visloc_companion.sim.real.programs import running\n"
        f"with running(['sleep', '600'], pathlib.Path({str(tmp_path)!r}), {{}}) as one:\n"
        "    print(one.pid, flush=True)\n    time.sleep(600)\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    assert is_alive(pid)
    parent.kill()
    parent.wait()
    parent.stdout.close()
    try:
        for _ in range(100):
            if not is_alive(pid):
                return
            time.sleep(0.05)
        pytest.fail("the program goes on")
    finally:
        if is_alive(pid):
            os.kill(pid, signal.SIGKILL)


def test_a_flight_whose_process_is_killed_is_told_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VISLOC_PX4", sys.executable)
    monkeypatch.setattr(apart, "_fly", killed)
    with pytest.raises(WorkerError, match=r"the process of the flight was killed; remedy: .*memory"):
        fly_apart(Simulator.PX4, real_scenario("jam", Simulator.PX4))


def killed(*_: object) -> NoReturn:
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError


def test_a_folder_is_meant_from_where_the_flight_was_asked_for(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The autopilot's program runs in the folder: a name relative to that would be another one."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("VISLOC_PX4", sys.executable)
    monkeypatch.setattr(apart, "_fly", told_folder)
    with pytest.raises(ConfigError, match=f"{tmp_path}/kept"):
        fly_apart(Simulator.PX4, real_scenario("jam", Simulator.PX4), keep=Path("kept"))


def told_folder(_simulator: Simulator, _program: Path, _scenario: object, _speed: float, keep: Path) -> NoReturn:
    raise ConfigError(str(keep))
