"""One flight of the real daemon with a real autopilot in its own simulator, on the simulator's time.

The daemon is app/live.py's, with its link, navigator and encoder; only its eyes are replaced (oracle.py). The ground station
flies the vehicle: take-off, a circuit, what goes wrong and when, landing.
"""

from __future__ import annotations

import asyncio
import contextlib
from pathlib import Path

from visloc_companion.errors import LinkError
from visloc_companion.sim.real.clock import EPOCH_NS, SlavedClock
from visloc_companion.sim.real.lives import DaemonLives
from visloc_companion.sim.real.operator import OperatorsHand
from visloc_companion.sim.real.pilot import DAEMON_PORT, SIMULATOR_PORT, Pilot
from visloc_companion.sim.real.programs import Running, running
from visloc_companion.sim.real.record import RealLog
from visloc_companion.sim.real.recorder import Recorder
from visloc_companion.sim.real.relay import Relay
from visloc_companion.sim.real.scenario import RealScenario, timeline
from visloc_companion.sim.real.station import Station

_NS_PER_S = 1_000_000_000
LAND_AFTER_S = 2.0
NAP_S, NAPS = 0.02, 200
SILENT_BEATS = 15
"""Heartbeats of NAPS naps, a minute, for which simulated time stood still: what waits for it would wait for ever. They are
counted, not timed: while a picture is rendered the simulator is held, and this process does nothing else."""


async def fly(pilot: Pilot, program: Path, scenario: RealScenario, folder: Path, speed: float = 1.0) -> RealLog:
    """Fly one scenario; the program's files and the daemon's journals are left in `folder`.

    `speed` is what the simulator is asked for; the daemon lives by the simulator's time whatever it reaches.
    Raises LinkError where the vehicle does not do as it is told before anything was done to it, OSError for ports in use.
    """
    clock, log = SlavedClock(), RealLog(program=str(program), speed=speed)
    recorder = Recorder(pilot, clock, log)
    station = Station(pilot.station_url, clock, recorder.hear)
    recorder.station = station
    await station.open()
    relay = Relay(SIMULATOR_PORT, DAEMON_PORT, recorder.overhear, pilot.passed)
    await relay.open()
    command, environment = pilot.command(program, folder, speed, scenario.gnss_at_boot)
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
    until_stopped = list[asyncio.Task[None]]()
    lives = DaemonLives(pilot, scenario, folder, recorder, simulator) if scenario.with_daemon else None
    if lives is not None:
        until_stopped.append(asyncio.create_task(lives.run(stop)))
    for_ever = [asyncio.create_task(_keep_alive(station, recorder.clock, simulator))]
    if scenario.operator is not None:
        for_ever.append(asyncio.create_task(OperatorsHand(scenario.operator, pilot, station, recorder).serve()))
    flight = asyncio.create_task(_stages(pilot, scenario, station, recorder, lives))
    work = [flight, *for_ever, *until_stopped]
    try:
        await asyncio.wait(work, return_when=asyncio.FIRST_COMPLETED)
        for task in work:
            if task.done():
                task.result()
    finally:
        stop.set()
        for task in (flight, *for_ever):
            task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.gather(*work, return_exceptions=True)


async def _keep_alive(station: Station, clock: SlavedClock, simulator: Running) -> None:
    """The ground station's heartbeat; ends with an error when the simulator's program does, or goes on without a word."""
    silent = 0
    while not simulator.ended and silent < SILENT_BEATS:
        station.heartbeat()
        since_ns = clock.now_ns()
        for _ in range(NAPS):
            if clock.now_ns() >= since_ns + _NS_PER_S or simulator.ended:
                break
            await asyncio.sleep(NAP_S)
        stands = clock.now_ns() == since_ns > EPOCH_NS  # before its first time it may still be asked for its messages
        silent = silent + 1 if stands else 0
    if not simulator.ended:
        what = f"the simulator runs, but for a minute its time stood still: {simulator.last_words()}"
        raise LinkError(what, remedy="fly again; if that helps nothing, run its command by hand")
    raise LinkError(f"the simulator ended by itself: {simulator.last_words()}", remedy="run its command by hand")


async def _stages(pilot: Pilot, scenario: RealScenario, station: Station, recorder: Recorder, lives: DaemonLives | None) -> None:
    await pilot.prepare(station, scenario.gnss_at_boot)
    recorder.mark("ready")
    recorder.log.build = await station.build()
    if scenario.gnss_at_boot:
        await pilot.take_off(station, scenario.route)
    else:
        recorder.show_frames()
        await pilot.climb_by_hand(station, scenario.route)
    recorder.mark("begun")
    recorder.show_frames(begun=True)
    begun_ns = recorder.clock.now_ns()
    for at_s, deed in timeline(scenario):
        await recorder.clock.sleep_until(begun_ns + round(at_s * _NS_PER_S))
        await _do(deed, at_s, scenario, pilot, station, recorder, lives)
    await recorder.clock.sleep_until(begun_ns + round(scenario.duration_s * _NS_PER_S))
    recorder.mark("over")
    if scenario.lands:
        await pilot.land(station)
        recorder.mark("landed")
        await recorder.clock.sleep_until(recorder.clock.now_ns() + round(LAND_AFTER_S * _NS_PER_S))


async def _do(
    deed: str,
    at_s: float,
    scenario: RealScenario,
    pilot: Pilot,
    station: Station,
    recorder: Recorder,
    lives: DaemonLives | None,
) -> None:
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
    elif deed == "restart":
        recorder.mark("restart")
        if lives is not None:
            lives.kill()
    elif not recorder.failed:
        try:
            await (pilot.brake(station) if deed == "brake" else pilot.resume(station))
        except LinkError:
            recorder.mark(f"{deed} refused")  # an autopilot without a position refuses; the flight goes on as it is
