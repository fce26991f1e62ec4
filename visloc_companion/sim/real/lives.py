"""The daemon of a flight against a real simulator: `visloc run`'s, with other eyes; it may die in flight and be started again."""

from __future__ import annotations

import asyncio
import contextlib
from pathlib import Path
from typing import cast

from visloc_companion.adapters.systemd.notify import Notifier
from visloc_companion.app.constructors import CONSTRUCTORS
from visloc_companion.app.journal import JournalWriter
from visloc_companion.app.live import Daemon
from visloc_companion.app.parts import Parts, journal_header
from visloc_companion.app.worker import WorkerSupervisor
from visloc_companion.config import Config, InjectionConfig, JournalConfig, LinkConfig, LocaliserConfig, StatusConfig
from visloc_companion.protocols import Clock
from visloc_companion.sim.real.oracle import Oracle
from visloc_companion.sim.real.pilot import Pilot
from visloc_companion.sim.real.programs import Running
from visloc_companion.sim.real.recorder import Recorder
from visloc_companion.sim.real.rendered import RenderedEyes
from visloc_companion.sim.real.scenario import RealScenario

SOCKET = "status.sock"


def flight_config(scenario: RealScenario) -> Config:
    """The configuration of a flight: defaults, but the daemon may switch the source where no operator does, and fixes come at the
    oracle's rate."""
    return Config(
        injection=InjectionConfig(switch_source=scenario.operator is None),
        localiser=LocaliserConfig(max_rate_hz=scenario.oracle.rate_hz, structure=False, threads=1),
        seed=scenario.seed,
    )


def daemon_config(pilot: Pilot, scenario: RealScenario, folder: Path) -> Config:
    """The same with the daemon's link and journal, and a status socket, beside which it leaves word to the next one."""
    parts = {
        "link": LinkConfig(url=pilot.daemon_url),
        "journal": JournalConfig(folder=str(folder)),
        "status": StatusConfig(socket=str(folder / SOCKET)),
    }
    return flight_config(scenario).model_copy(update=parts)


class DaemonLives:
    """Runs the daemon; each life writes a journal of its own into the folder."""

    def __init__(self, pilot: Pilot, scenario: RealScenario, folder: Path, recorder: Recorder, simulator: Running) -> None:
        self._pilot, self._scenario, self._folder, self._recorder = pilot, scenario, folder, recorder
        eyes = None if scenario.seen is None else RenderedEyes(scenario.seen, flight_config(scenario), simulator)
        self._oracle = Oracle(scenario.oracle, recorder.clock, scenario.seed, eyes, scenario.home.h_amsl_m)
        recorder.oracle = self._oracle
        self._killed = asyncio.Event()

    def kill(self) -> None:
        """The daemon dies at once, without a word to the autopilot; the next one starts a while later."""
        self._killed.set()

    async def run(self, stop: asyncio.Event) -> None:
        """Serve, life after life, until `stop`."""
        clock, answering = self._recorder.clock, asyncio.create_task(self._oracle.serve())
        try:
            while not stop.is_set():
                self._killed.clear()
                life, death = asyncio.create_task(self._live(stop)), asyncio.create_task(self._killed.wait())
                try:
                    await asyncio.wait({life, death}, return_when=asyncio.FIRST_COMPLETED)
                    if life.done():
                        life.result()
                finally:
                    for task in (life, death):
                        task.cancel()
                    await asyncio.gather(life, death, return_exceptions=True)
                if self._killed.is_set():
                    await _slept(clock, round(self._scenario.down_s * 1e9), stop)
        finally:
            answering.cancel()
            self._recorder.oracle = None

    async def _live(self, stop: asyncio.Event) -> None:
        recorder, oracle = self._recorder, self._oracle
        config = daemon_config(self._pilot, self._scenario, self._folder)
        journal = JournalWriter.create(
            self._folder, journal_header(config, recorder.clock.now_ns()), max_bytes=config.journal.max_bytes
        )
        recorder.journal = journal
        parts = Parts(config, recorder.clock, journal=cast(JournalWriter, recorder))
        warned, left = recorder.log.warnings.append, parts.handover.left
        link = parts.link = CONSTRUCTORS.link(config, recorder.clock, recorder.raw, warned, left)
        parts.worker = cast(WorkerSupervisor, oracle)
        daemon = Daemon(parts, CONSTRUCTORS, Notifier({}))
        oracle.on_frame = daemon.handle
        try:
            await daemon.run(stop)
        finally:
            recorder.journal = None
            oracle.forget()
            with contextlib.suppress(OSError):
                await link.close()
            journal.close()


async def _slept(clock: Clock, ns: int, stop: asyncio.Event) -> None:
    """Return after so long, or at `stop`: where the simulator has ended its time stands still."""
    waits = [asyncio.create_task(clock.sleep_until(clock.now_ns() + ns)), asyncio.create_task(stop.wait())]
    try:
        await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in waits:
            task.cancel()
        await asyncio.gather(*waits, return_exceptions=True)
