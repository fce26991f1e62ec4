"""A flight in a process and a network of its own, so that several may run on one machine and none can be reached."""

from __future__ import annotations

import asyncio
import multiprocessing
import tempfile
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import structlog

from visloc_companion.app.with_parent import end_with_parent
from visloc_companion.errors import ConfigError, WorkerError
from visloc_companion.sim.real.ardupilot import ArduPilot
from visloc_companion.sim.real.flight import fly
from visloc_companion.sim.real.network import enter_own_network
from visloc_companion.sim.real.pilot import HOME, Pilot
from visloc_companion.sim.real.priority import go_first
from visloc_companion.sim.real.programs import Simulator, find_program, kill_all
from visloc_companion.sim.real.px4 import Px4
from visloc_companion.sim.real.record import RealLog, write_csv
from visloc_companion.sim.real.scenario import RealScenario
from visloc_companion.types import GeoPoint

DAEMON_LOG, SAMPLES = "daemon.log", "samples.csv"
PARAMETERS = Path(__file__).resolve().parents[3] / "docs" / "parameters"


def make_pilot(
    simulator: Simulator, parameters: Path = PARAMETERS, home: GeoPoint = HOME, drag_per_s: float | None = None
) -> Pilot:
    """The particulars of a simulator whose vehicle stands at `home`, with the parameter file that users are told to load.

    `drag_per_s`: of PX4's quadrotor (SIH_KDV over its mass of 1 kg). Raises ConfigError where `parameters` (the folder) lacks the
    file.
    """
    file = parameters / ("px4.parm" if simulator.is_px4 else "ardupilot.parm")
    if not file.is_file():
        raise ConfigError("is missing", where=str(file), remedy="run in a checkout of the project")
    if not simulator.is_px4:
        return ArduPilot(simulator.is_plane, file, home)
    return Px4(simulator.is_plane, file, home, {} if drag_per_s is None else {"SIH_KDV": f"{drag_per_s:g}"})


def fly_apart(simulator: Simulator, scenario: RealScenario, *, speed: float = 1.0, keep: Path | None = None) -> RealLog:
    """Fly one scenario; what the program and the daemon write goes to the empty folder `keep`, else away with a temporary one.

    Raises ConfigError where the program or the system's permission is missing, or `keep` holds something: an autopilot would take
    up the parameters that a former flight left there. Raises LinkError where the flight could not be begun, WorkerError where its
    process is killed.
    """
    program = find_program(simulator)
    if keep is not None and keep.exists() and any(keep.iterdir()):
        why = "holds something already: the autopilot would fly with the parameters that another flight left"
        raise ConfigError(why, where=str(keep), remedy="name a new folder, or empty it")
    try:
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
            return pool.submit(_fly, simulator, program, scenario, speed, None if keep is None else keep.absolute()).result()
    except BrokenProcessPool as why:
        remedy = "where memory ran out (dmesg tells): end other work, and fly again"
        raise WorkerError("the process of the flight was killed", remedy=remedy) from why


def _fly(simulator: Simulator, program: Path, scenario: RealScenario, speed: float, keep: Path | None) -> RealLog:
    enter_own_network()  # before any thread
    end_with_parent(kill_all)
    go_first()
    pilot = make_pilot(simulator, home=scenario.home, drag_per_s=scenario.drag_per_s)
    with tempfile.TemporaryDirectory(prefix="visloc-real-") as temporary:
        folder = Path(temporary) if keep is None else keep
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / DAEMON_LOG).open("w", encoding="utf-8") as file:
            structlog.configure(logger_factory=structlog.PrintLoggerFactory(file))
            log = asyncio.run(fly(pilot, program, scenario, folder, speed))
        write_csv(log.samples, folder / SAMPLES)
        return log
