"""The live daemon: one event loop that carries events into the navigator and its commands out into the world.

Everything that happens is an event, and every event goes through `Daemon.handle`: it is journalled, given to the navigator,
and the commands that come back are journalled and dispatched. Nothing else decides anything, which is why app/replay.py can
repeat a flight from its journal byte for byte.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Callable, Coroutine
from dataclasses import asdict
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import structlog

from visloc_companion.adapters.systemd.notify import Notifier
from visloc_companion.app.camera_feed import CameraFeed
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.app.constructors import CONSTRUCTORS
from visloc_companion.app.first_position import At, FirstPosition
from visloc_companion.app.ground_check import GroundCheck
from visloc_companion.app.ground_reports import Condition, GroundReports
from visloc_companion.app.health import Health
from visloc_companion.app.mailbox import Mailbox
from visloc_companion.app.parts import Constructors, Parts, Reports, assemble
from visloc_companion.app.seen import Seen
from visloc_companion.app.serialise import to_json
from visloc_companion.app.settings import core_settings
from visloc_companion.app.slow_line import SlowLine
from visloc_companion.app.status import status_server
from visloc_companion.app.ticker import time_grid
from visloc_companion.app.worker_ahead import WorkerAhead
from visloc_companion.config import Config
from visloc_companion.errors import LinkError
from visloc_companion.protocols import Clock, FrameSlots
from visloc_companion.types import (
    Command,
    Event,
    FrameRef,
    Injection,
    LinkChanged,
    LocaliseRequest,
    Notice,
    RequestMessage,
    Severity,
    Status,
    SwitchSource,
    TerrainRequest,
    Tick,
)

log = structlog.get_logger("visloc")

SLOW_STEP_NS = 2_000_000
LIMITS_S = {"link": 10.0, "camera": 15.0, "worker": 10.0, "tick": 3.0}
_ORDERS_AT_ONCE = 32
_WATCH_S = 0.5
_NAVIGATOR = "visloc_companion.core.navigator"
"""Imported while the worker starts: with SciPy it takes most of a second."""


class Daemon:
    """A daemon whose parts are assembled. `run` serves until `stop` is set."""

    def __init__(self, parts: Parts, make: Constructors, notifier: Notifier, at: At | None = None) -> None:
        if parts.link is None:
            raise ValueError("a daemon needs a link")
        from visloc_companion.core.navigator import Navigator  # run_daemon imports it beside the worker's start

        self.parts, self.link = parts, parts.link
        self.navigator = Navigator(core_settings(parts.config))
        self.status: Status | None = None
        self._seen, self._line = Seen(), SlowLine()
        self.health = Health({part: limit for part, limit in LIMITS_S.items() if part != "camera" or parts.camera is not None})
        self.slow_steps = self.slowest_ns = self.orders_dropped = 0
        self._make, self._notifier = make, notifier
        self._wall = MonotonicClock()  # health is about this process, whatever speed the flight's clock has
        self._injections: Mailbox[Injection] = Mailbox(2, newest_wins=True)
        self._notices: Mailbox[Notice] = Mailbox(16, newest_wins=True)
        self._orders: set[asyncio.Task[None]] = set()
        self._group: asyncio.TaskGroup | None = None
        self._link_up = self._stopping = False
        self._ground = GroundCheck(parts.config, parts.clock, self.handle)
        self._reports = GroundReports(parts.config, parts.clock, self._condition, self.link.report)
        self._first = FirstPosition(at)

    # ------------------------------------------------------------------------------------------------- events, commands

    def handle(self, event: Event) -> None:
        """Give an event to the navigator and do what it says."""
        if self._stopping:
            return
        now_ns, journal = self.parts.clock.now_ns(), self.parts.journal
        begun_ns = self._wall.now_ns()
        if journal is not None:
            journal.event(now_ns, event)
        self._seen.event(event)
        for command in self.navigator.on(event, now_ns):
            if journal is not None:
                journal.command(now_ns, command)
            self._seen.command(now_ns, command)
            self.parts.handover.did(command, self._pack_seal())
            self._dispatch(command)
        spent_ns = self._wall.now_ns() - begun_ns
        self.slow_steps += spent_ns > SLOW_STEP_NS
        self.slowest_ns = max(self.slowest_ns, spent_ns)

    def _dispatch(self, command: Command) -> None:
        match command:
            case Status():
                self.status = command
            case Injection():
                self._injections.put(command)
            case LocaliseRequest() | TerrainRequest():
                if self.parts.worker is not None:
                    self.parts.worker.submit(command)
            case RequestMessage() | SwitchSource():
                self._order(command)
            case Notice():
                self._tell(command)

    def _pack_seal(self) -> str:
        return "" if self.parts.worker is None else self.parts.worker.pack_seal

    def report(self, notice: Notice) -> None:
        """The shell's own notice: logged, journalled apart from the navigator's, and sent where it is for the operator."""
        now_ns = self.parts.clock.now_ns()
        if self.parts.journal is not None:
            self.parts.journal.notice(now_ns, notice)
        self._seen.command(now_ns, notice)
        self._tell(notice)

    def _tell(self, notice: Notice) -> None:
        level = {Severity.INFO: "info", Severity.NOTICE: "info", Severity.WARNING: "warning"}.get(notice.severity, "error")
        getattr(log, level)(notice.text, **{name.replace("event", "event_"): value for name, value in notice.data})
        if notice.to_operator:
            self._notices.put(notice)

    def _order(self, command: RequestMessage | SwitchSource) -> None:
        """The autopilot answers within seconds, so each order waits in a task of its own; there are at most 32 for messages,
        which may wait long for what is not sent. One that switches the source is never dropped for them."""
        full = isinstance(command, RequestMessage) and len(self._orders) >= _ORDERS_AT_ONCE
        if self._group is None or full:
            self.orders_dropped += 1
            return
        task = self._group.create_task(self._carry_out(command))
        self._orders.add(task)
        task.add_done_callback(self._orders.discard)

    async def _carry_out(self, command: RequestMessage | SwitchSource) -> None:
        if isinstance(command, SwitchSource):
            await self.link.switch(command)  # SourceSwitched tells the navigator
        elif not await self.link.request(command):
            log.warning("the autopilot does not stream a message", message_id=command.message_id, rate_hz=command.rate_hz)

    # ------------------------------------------------------------------------------------------------------------ tasks

    async def run(self, stop: asyncio.Event) -> None:
        """Serve until `stop`. Then injection stops first; closing the other parts is the caller's."""
        self.health.start(self._wall.now_ns())
        try:
            async with asyncio.TaskGroup() as group:
                self._group = group
                tasks = [group.create_task(work, name=name) for name, work in self._work().items()]
                self._notifier.ready()
                log.info("ready")
                await stop.wait()
                self._stopping = True
                self._injections.clear()
                self._notifier.stopping()
                await self.link.close()
                for task in (*tasks, *self._orders):
                    task.cancel()
        finally:
            self._stopping, self._group = True, None
            if self.parts.journal is not None:
                self.parts.journal.notice(self.parts.clock.now_ns(), Notice(Severity.INFO, "stopped"))
            log.info("stopped", slow_steps=self.slow_steps, cycle_slips=self.health.cycle_slips)

    def _work(self) -> dict[str, Coroutine[Any, Any, None]]:
        work = {
            "link": self._serve_link(),
            "tick": self._serve_ticks(),
            "injections": self._send_injections(),
            "notices": self._send_notices(),
            "watch": self._watch(),
            "reports": self._reports.serve(),
        }
        if self.parts.config.map.pack:
            work["ground"] = self._ground.serve()
        if self.parts.worker is not None:
            work["worker"] = self._serve_worker()
        if self.parts.camera is not None and self.parts.slots is not None:
            work["camera"] = self._serve_camera(self.parts.slots)
        return work

    async def _serve_link(self) -> None:
        async for event in self.link.events() if self.parts.heard is None else self.parts.heard:
            self.health.beat("link", self._wall.now_ns())
            if isinstance(event, LinkChanged):
                self._link_up = event.up
            self._ground.heard(event)
            self.handle(event)
            found = self.parts.handover.heard(event)
            if found is not None and self._first.outdated():
                self.report(Notice(Severity.WARNING, "visloc: restarted in flight, --at passed over", True))
            for told in (found, self._first.heard(event)):
                if told is not None:
                    self.handle(told)
        if not self._stopping:
            raise LinkError("ended by itself", where=self.parts.config.link.url, remedy="this is a fault; start visloc again")

    async def _serve_ticks(self) -> None:
        rate_hz = self.parts.config.navigator.output_rate_hz
        self.handle(Tick(self.parts.clock.now_ns()))  # what was heard while the worker started need not wait for the grid
        async for now_ns, slipped in time_grid(self.parts.clock, rate_hz):
            self.health.tick(self._wall.now_ns(), slipped)
            self.handle(Tick(now_ns))

    async def _serve_worker(self) -> None:
        worker = self.parts.worker
        while worker is not None:
            self.handle(await worker.events.get())

    async def _send_injections(self) -> None:
        while True:
            await self.link.send(await self._injections.get())

    async def _send_notices(self) -> None:
        while True:
            await self.link.notify(await self._notices.get())

    def _take(self, frame: FrameRef) -> None:
        """A frame has come: note which one lies in its slot, record it if wished, and tell the navigator."""
        slots, journal = self.parts.slots, self.parts.journal
        if slots is None:
            return
        slots.announce(frame)
        if journal is not None and self.parts.config.journal.record_frames:
            journal.frame(self.parts.clock.now_ns(), frame, slots.read(frame))
        self.handle(frame)

    async def _serve_camera(self, slots: FrameSlots) -> None:
        feed = CameraFeed(
            self.parts,
            slots,
            self._make.camera,
            self.report,
            lambda: self.health.beat("camera", self._wall.now_ns()),
            lambda: self.status is not None and self.status.injected,
        )
        async for frame in feed.frames():
            self._take(frame)
        self.health.limits_s.pop("camera", None)

    # ----------------------------------------------------------------------------------------------------------- health

    def _condition(self) -> Condition:
        worker, journal = self.parts.worker, self.parts.journal
        withheld = self.status is not None and self.status.injected and bool(self.link.withheld)
        faulty = bool(self.health.late(self._wall.now_ns())) or (worker is not None and worker.given_up) or withheld
        return Condition(self.status, faulty, recording=journal is not None and not journal.problem)

    async def _watch(self) -> None:
        """Beat the watchdog while all parts beat; say which do not."""
        late: list[str] = []
        rounds = -1
        while True:
            now_ns = self._wall.now_ns()
            before, rounds = rounds, self.link.rounds
            if not self._link_up or rounds != before:
                self.health.beat("link", now_ns)  # it connects again, or listens to an autopilot that may say nothing of use
            if self.parts.worker is None or not self.parts.worker.overdue:
                self.health.beat("worker", now_ns)
            was_late, late = late, self.health.late(now_ns)
            if late and late != was_late:
                ages = tuple((f"{part}_s", age) for part, age in self.health.ages_s(now_ns).items())
                self.report(Notice(Severity.CRITICAL, f"hangs: {', '.join(late)}", data=ages))
            if not late:
                self._notifier.watchdog()
            slow = self._line.seen(self.link.left_out, now_ns)
            if slow is not None:
                self.report(slow)
            await asyncio.sleep(min(_WATCH_S, (self._notifier.watchdog_s or 60.0) / 4))

    def snapshot(self) -> dict[str, Any]:
        """State for other processes (app/status.py)."""
        journal, worker, now_ns = self.parts.journal, self.parts.worker, self.parts.clock.now_ns()
        return {
            "schema": 1,
            "t_ns": now_ns,
            "status": None if self.status is None else json.loads(to_json(self.status)),
            "link_up": self._link_up,
            "line": {"left_out": self.link.left_out, "slow": self._line.slow},
            "worker": None
            if worker is None
            else {
                "up": worker.up,
                "pid": worker.pid,
                "restarts": worker.restarts,
                "given_up": worker.given_up,
            },
            "journal": None if journal is None else {"dropped": journal.dropped, "problem": journal.problem},
            "computer": None if self._reports.load is None else asdict(self._reports.load),
            "cycle_slips": self.health.cycle_slips,
            "slow_steps": self.slow_steps,
            "slowest_ms": self.slowest_ns / 1e6,
            "injections": {
                "sent": self.link.n_sent,
                "dropped": self._injections.dropped,
                "withheld": self.link.withheld,
            },
            "late": self.health.late(self._wall.now_ns()),
            "camera": self.parts.camera is not None,
            **self._seen.snapshot(now_ns),
        }


async def run_daemon(
    config: Config,
    *,
    stop: asyncio.Event | None = None,
    clock: Clock | None = None,
    make: Constructors | None = None,
    notifier: Notifier | None = None,
    on_ready: Callable[[Daemon], None] | None = None,
    at: At | None = None,
    ahead: WorkerAhead | None = None,
) -> None:
    """Assemble and serve until `stop` is set; `at`: where the vehicle is, as the operator says; `ahead` waits to be the worker.

    Raises StartFailed with all that stands against the start.
    """
    clock = MonotonicClock(config.clock.speed) if clock is None else clock
    make = CONSTRUCTORS if make is None else make
    notifier = Notifier() if notifier is None else notifier
    loop, early, daemons = asyncio.get_running_loop(), list[Notice](), list[Daemon]()

    def report(notice: Notice) -> None:
        daemons[0].report(notice) if daemons else early.append(notice)

    def disk_problem(where: str, text: str) -> None:
        data = (("problem", text), ("where", where), ("remedy", "make room there, or name another place"))
        with contextlib.suppress(RuntimeError):  # the loop has ended, and with it whom to tell
            loop.call_soon_threadsafe(report, Notice(Severity.WARNING, f"visloc: {text}"[:50], True, data))

    def link_warning(text: str) -> None:
        report(Notice(Severity.WARNING, text))

    stop = asyncio.Event() if stop is None else stop
    journal_problem = partial(disk_problem, f"journal.folder = {config.journal.folder}")
    assembling = asyncio.create_task(assemble(config, clock, make, Reports(report, journal_problem, link_warning), ahead))
    importing = asyncio.create_task(asyncio.to_thread(import_module, _NAVIGATOR))
    try:
        parts = await _unless(stop, assembling)
    finally:
        await importing
    if parts is None:
        return
    try:
        daemon = Daemon(parts, make, notifier, at)
        daemons.append(daemon)
        for notice in early:
            daemon.report(notice)
        async with contextlib.AsyncExitStack() as stack:
            if config.status.socket:
                no_socket = partial(disk_problem, f"status.socket = {config.status.socket}")
                await stack.enter_async_context(status_server(Path(config.status.socket), daemon.snapshot, no_socket))
            if on_ready is not None:
                on_ready(daemon)
            await daemon.run(stop)
    finally:
        await parts.close()


async def _unless(stop: asyncio.Event, assembling: asyncio.Task[Parts]) -> Parts | None:
    """The parts, or None where the daemon is stopped while it still starts (hashing a large map takes its time)."""
    stopped = asyncio.create_task(stop.wait())
    try:
        await asyncio.wait({stopped, assembling}, return_when=asyncio.FIRST_COMPLETED)
        if assembling.done():
            return assembling.result()
        return None
    finally:
        for task in (stopped, assembling):
            task.cancel()
        await asyncio.gather(stopped, assembling, return_exceptions=True)
