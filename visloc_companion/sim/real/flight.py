"""One flight of the real daemon with a real autopilot in its own simulator, on the simulator's time.

The daemon is app/live.py's, with its link, navigator and encoder; only its eyes are replaced (oracle.py). The ground station
flies the vehicle: take-off with GNSS, a circuit, what goes wrong and when, landing.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

from visloc_companion.adapters.systemd.notify import Notifier
from visloc_companion.app.constructors import CONSTRUCTORS
from visloc_companion.app.journal import JournalWriter
from visloc_companion.app.live import Daemon
from visloc_companion.app.parts import Parts, journal_header
from visloc_companion.app.worker import WorkerSupervisor
from visloc_companion.config import Config, InjectionConfig, JournalConfig, LinkConfig, LocaliserConfig
from visloc_companion.errors import LinkError
from visloc_companion.sim.real.clock import EPOCH_NS, SlavedClock
from visloc_companion.sim.real.oracle import Oracle, OracleSettings
from visloc_companion.sim.real.pilot import DAEMON_PORT, SIMULATOR_PORT, Pilot, Route
from visloc_companion.sim.real.programs import Running, running
from visloc_companion.sim.real.record import RealLog
from visloc_companion.sim.real.recorder import Recorder
from visloc_companion.sim.real.relay import Relay
from visloc_companion.sim.real.station import Station

_NS_PER_S = 1_000_000_000
DRAG_STEP_S = 0.5
LAND_AFTER_S = 2.0


@dataclass(frozen=True, slots=True)
class Brake:
    """A copter brakes as hard as it can at `at_s`, stands for `hold_s` and goes on."""

    at_s: float
    hold_s: float = 4.0


@dataclass(frozen=True, slots=True)
class RealScenario:
    """What happens, in seconds since the circuit was begun; None is never.

    `drag_mps` (north, east) pulls the receiver's position away from `drag_at_s` on. The flight lasts `duration_s`, then lands
    where `lands`.
    """

    name: str
    route: Route
    duration_s: float
    jam_at_s: float | None = None
    gnss_back_at_s: float | None = None
    drag_at_s: float | None = None
    drag_mps: tuple[float, float] = (0.0, 1.0)
    brakes: tuple[Brake, ...] = ()
    with_daemon: bool = True
    lands: bool = True
    oracle: OracleSettings = field(default_factory=OracleSettings)
    seed: int = 1


def daemon_config(pilot: Pilot, scenario: RealScenario, folder: Path) -> Config:
    """The daemon's configuration: defaults, but it may switch the source, and fixes come at the oracle's rate."""
    return Config(
        link=LinkConfig(url=pilot.daemon_url),
        injection=InjectionConfig(switch_source=True),
        localiser=LocaliserConfig(max_rate_hz=scenario.oracle.rate_hz, structure=False),
        journal=JournalConfig(folder=str(folder)),
        seed=scenario.seed,
    )


async def fly(pilot: Pilot, program: Path, scenario: RealScenario, folder: Path, speed: float = 1.0) -> RealLog:
    """Fly one scenario; the program's files and the daemon's journal are left in `folder`.

    `speed` is what the simulator is asked for; the daemon lives by the simulator's time whatever it reaches.
    Raises LinkError where the vehicle does not do as it is told before anything was done to it, OSError for ports in use.
    """
    clock, log = SlavedClock(), RealLog(program=str(program), speed=speed)
    recorder = Recorder(pilot, clock, log)
    station = Station(pilot.station_url, clock, recorder.hear)
    recorder.station = station
    await station.open()
    relay = Relay(SIMULATOR_PORT, DAEMON_PORT, recorder.overhear, pilot.withheld)
    await relay.open()
    command, environment = pilot.command(program, folder, speed)
    try:
        with running(command, folder, environment) as simulator:
            await _fly(pilot, scenario, folder, station, recorder, simulator)
    finally:
        relay.close()
        station.close()
    log.texts = [((t_ns - EPOCH_NS) / _NS_PER_S, text) for t_ns, text in station.texts]
    return log


async def _fly(
    pilot: Pilot, scenario: RealScenario, folder: Path, station: Station, recorder: Recorder, simulator: Running
) -> None:
    stop = asyncio.Event()
    work = [asyncio.create_task(_keep_alive(station, recorder.clock, simulator))]
    if scenario.with_daemon:
        work.append(asyncio.create_task(_serve_daemon(pilot, scenario, folder, recorder, stop)))
    flight = asyncio.create_task(_stages(pilot, scenario, station, recorder))
    try:
        await asyncio.wait({flight, *work}, return_when=asyncio.FIRST_COMPLETED)
        for task in (flight, *work):
            if task.done():
                task.result()
    finally:
        stop.set()
        flight.cancel()
        work[0].cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.gather(flight, *work, return_exceptions=True)


async def _keep_alive(station: Station, clock: SlavedClock, simulator: Running) -> None:
    """The ground station's heartbeat; ends with an error when the simulator's program does."""
    while not simulator.ended:
        station.heartbeat()
        until_ns = clock.now_ns() + _NS_PER_S
        for _ in range(200):
            if clock.now_ns() >= until_ns or simulator.ended:
                break
            await asyncio.sleep(0.02)
    raise LinkError(f"the simulator ended by itself: {simulator.last_words()}", remedy="run its command by hand")


async def _serve_daemon(pilot: Pilot, scenario: RealScenario, folder: Path, recorder: Recorder, stop: asyncio.Event) -> None:
    config = daemon_config(pilot, scenario, folder)
    journal = JournalWriter.create(folder, journal_header(config, recorder.clock), max_bytes=config.journal.max_bytes)
    recorder.journal = journal
    tap = cast(JournalWriter, recorder)
    link = CONSTRUCTORS.link(config, recorder.clock, recorder.raw, recorder.log.warnings.append)
    parts = Parts(config, recorder.clock, link, journal=tap)
    oracle = Oracle(scenario.oracle, recorder.clock, scenario.seed)
    parts.worker = cast(WorkerSupervisor, oracle)
    daemon = Daemon(parts, CONSTRUCTORS, Notifier({}))
    oracle.on_frame = daemon.handle
    recorder.oracle = oracle
    answering = asyncio.create_task(oracle.serve())
    try:
        await daemon.run(stop)
    finally:
        answering.cancel()
        recorder.oracle = None
        journal.close()


async def _stages(pilot: Pilot, scenario: RealScenario, station: Station, recorder: Recorder) -> None:
    await pilot.prepare(station)
    recorder.mark("ready")
    await pilot.take_off(station, scenario.route)
    recorder.mark("begun")
    if recorder.oracle is not None:
        recorder.oracle.shows = True
    begun_ns = recorder.clock.now_ns()
    for at_s, deed in _timeline(scenario):
        await recorder.clock.sleep_until(begun_ns + round(at_s * _NS_PER_S))
        await _do(deed, at_s, scenario, pilot, station, recorder)
    await recorder.clock.sleep_until(begun_ns + round(scenario.duration_s * _NS_PER_S))
    recorder.mark("over")
    if scenario.lands:
        await pilot.land(station)
        recorder.mark("landed")
        await recorder.clock.sleep_until(recorder.clock.now_ns() + round(LAND_AFTER_S * _NS_PER_S))


def _timeline(scenario: RealScenario) -> Sequence[tuple[float, str]]:
    """What is done when, in order."""
    deeds: list[tuple[float, str]] = []
    if scenario.jam_at_s is not None:
        deeds.append((scenario.jam_at_s, "jam"))
    if scenario.gnss_back_at_s is not None:
        deeds.append((scenario.gnss_back_at_s, "back"))
    if scenario.drag_at_s is not None:
        ends_s = scenario.duration_s if scenario.jam_at_s is None else scenario.jam_at_s
        steps = int((ends_s - scenario.drag_at_s) / DRAG_STEP_S)
        deeds += [(scenario.drag_at_s + n * DRAG_STEP_S, "drag") for n in range(steps)]
    for brake in scenario.brakes:
        deeds += [(brake.at_s, "brake"), (brake.at_s + brake.hold_s, "resume")]
    return sorted(deed for deed in deeds if deed[0] < scenario.duration_s)


async def _do(deed: str, at_s: float, scenario: RealScenario, pilot: Pilot, station: Station, recorder: Recorder) -> None:
    if deed == "jam":
        await pilot.set_gnss(station, False)
        recorder.mark("jam")
    elif deed == "back":
        await pilot.set_gnss(station, True)
        recorder.mark("back")
    elif deed == "drag":
        since_s = at_s - (scenario.drag_at_s or 0.0)
        recorder.mark("drag")
        await pilot.drag_gnss(station, (since_s * scenario.drag_mps[0], since_s * scenario.drag_mps[1]))
    elif not recorder.failed:
        try:
            await (pilot.brake(station) if deed == "brake" else pilot.resume(station))
        except LinkError:
            recorder.mark(f"{deed} refused")  # an autopilot without a position refuses; the flight goes on as it is
