"""Keeps one localisation process alive: starts it, feeds it, kills it at the deadline, restarts it, and pauses where that fails.

A death is noticed at once by the process's sentinel. Whatever happens, every request is answered by exactly one Fix or NoFix,
and everything is told to the core by WorkerState events.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from visloc_companion.app.mailbox import Mailbox
from visloc_companion.app.patience import Patience
from visloc_companion.app.slots import SharedFrameSlots
from visloc_companion.app.worker_ahead import WorkerAhead, begun
from visloc_companion.app.worker_process import (
    REAL_ANSWERS,
    Changed,
    Failed,
    Faulty,
    Ready,
    WorkerJob,
    WorkerRequest,
    no_fix,
    run_worker,
)
from visloc_companion.config import Config
from visloc_companion.errors import MapError, Reason, VislocError, WorkerError
from visloc_companion.protocols import Clock
from visloc_companion.types import Fix, LocaliseRequest, NoFix, Notice, Severity, WorkerState

WorkerEvent = Fix | NoFix | WorkerState
FileStamps = tuple[tuple[str, int, int, int, int], ...]
_WINDOW_S = 60.0
_PAUSE_S = 60.0
"""After more deaths than `worker.max_restarts`: what kills a worker may pass (memory, heat)."""
_VAIN_S = 1.0
"""Before the next try after a worker that found map or network unfit to be opened; twice as long after each further one in a
row, and no longer than `_PAUSE_S`: a medium that was away for a moment is not one that costs a minute without fixes."""
_SCARCE_S = 2.0
"""Before the next try where the system has no memory, process or descriptor for one."""
_START_S = 120.0
_RESTART_S = 30.0
_STOP_S = 1.0
_LOOK_S = 10.0
"""For looking at the pack's files; a medium that takes longer hangs."""
_CAPACITY = 16


class WorkerSupervisor:
    """One spawned worker. `events` holds its answers and states; `submit` never blocks or raises.

    `known`: the `pack_seal` of the daemon before, whose pack need not be verified again. `ahead`: a process that waits to be the
    first worker.
    """

    def __init__(
        self,
        config: Config,
        slots: SharedFrameSlots,
        clock: Clock,
        *,
        on_notice: Callable[[Notice], None],
        factory: str = REAL_ANSWERS,
        known: str = "",
        ahead: WorkerAhead | None = None,
    ) -> None:
        self.events: Mailbox[WorkerEvent] = Mailbox(_CAPACITY, newest_wins=True)
        self.restarts = 0
        self.up = False
        self.given_up = False
        self._config, self._slots, self._clock = config, slots, clock
        self._on_notice, self._factory, self._known = on_notice, factory, known
        self._ahead = ahead
        self._process: Any = None
        self._connection: Connection | None = None
        self._in_flight: WorkerRequest | None = None
        self._deadline: asyncio.TimerHandle | None = None
        self._deaths: deque[float] = deque()
        self._started: asyncio.Future[None] | None = None
        self._why, self._reason = "", Reason.WORKER_DIED
        self._unfit: VislocError | None = None
        self._in_vain = 0
        self._closed = False
        self._stamps: FileStamps = ()
        self._verified: FileStamps = ()
        self.pack_seal = ""
        """Tells the files of the pack as they were verified from any others; empty where nothing was verified."""

    @property
    def pid(self) -> int | None:
        """Process number of the worker, None while there is none."""
        return None if self._process is None else int(self._process.pid)

    @property
    def alive(self) -> bool:
        """Whether answers can be expected: up, or being restarted."""
        return self._process is not None and not self.given_up

    @property
    def overdue(self) -> bool:
        """Whether a deadline has passed without anything being done about it; never, unless this class is at fault."""
        return self._deadline is not None and asyncio.get_running_loop().time() > self._deadline.when() + _STOP_S

    def begin(self) -> None:
        """Start the first worker's process; `start` waits for it."""
        self._started = asyncio.get_running_loop().create_future()
        self._stamps = file_stamps(self._config.map.pack)
        verify = self._config.map.verify_hashes
        if verify and self._known and seal(self._stamps) == self._known:
            self._on_notice(Notice(Severity.INFO, "the map pack is as the daemon before this one has verified it"))
            verify = False
        self._spawn(self._verifying(verify), _START_S)

    async def start(self) -> None:
        """Wait until the first worker, begun here unless it was, has opened map and localiser.

        Raises what stands against it (MapError, ModelError, ConfigError, WorkerError).
        """
        if self._started is None:
            self.begin()
        assert self._started is not None
        try:
            await self._started
        except BaseException:
            await self.close()
            raise

    def submit(self, request: WorkerRequest) -> None:
        """Hand over a request; the answer comes through `events`, also where there is no worker or no such frame."""
        if not self.up or self._connection is None:
            self._decline(request, Reason.WORKER_DIED, "there is no worker")
        elif self._in_flight is not None:
            self._decline(request, Reason.SUPERSEDED, "the worker is busy")
        elif isinstance(request, LocaliseRequest) and not self._slots.hold(request.frame):
            self._decline(request, Reason.SUPERSEDED, "a newer frame took the slot")
        else:
            self._in_flight = request
            patience = Patience(self._process.pid, self._config.worker.deadline_s)
            self._arm(patience.limit_s, self._overdue, patience)
            with contextlib.suppress(OSError):  # it died this instant: the sentinel says so and answers
                self._connection.send(request)

    async def close(self) -> None:
        """End the worker: politely, then by force. Nothing is reported any more."""
        self._closed, self.given_up, self.up = True, True, False
        process, connection = self._detach()
        if process is None or connection is None:
            return
        connection.close()  # the worker reads the end and returns
        loop, gone = asyncio.get_running_loop(), asyncio.Event()
        loop.add_reader(process.sentinel, gone.set)
        try:
            await asyncio.wait_for(gone.wait(), _STOP_S)
        except TimeoutError:
            pass  # it computes; it will not miss what it loses
        finally:
            loop.remove_reader(process.sentinel)
            process.kill()
            process.join()
            process.close()

    # ------------------------------------------------------------------------------------------------------------ inside

    def _spawn(self, config: Config, patience_s: float) -> None:
        job = WorkerJob(config, self._slots.name, self._factory)
        taken = None if self._ahead is None else self._ahead.take(job)
        process, ours = taken or begun(run_worker, job)
        self._process, self._connection, self._why, self._reason = process, ours, "", Reason.WORKER_DIED
        self._unfit = None
        loop = asyncio.get_running_loop()
        loop.add_reader(process.sentinel, self._died)
        loop.add_reader(ours.fileno(), self._receive)
        self._arm(patience_s, self._kill, f"the worker did not start within {patience_s:g} s", Reason.WORKER_DIED)

    def _overdue(self, patience: Patience) -> None:
        """No answer yet: wait on until the worker has computed for its time."""
        if patience.lasts():
            self._arm(patience.limit_s, self._overdue, patience)
        else:
            self._kill(f"a localisation took longer than {patience.limit_s:g} s", Reason.WORKER_TIMEOUT)

    def _arm(self, after_s: float, then: Callable[..., None], *about: object) -> None:
        self._disarm()
        self._deadline = asyncio.get_running_loop().call_later(after_s, then, *about)

    def _disarm(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _kill(self, why: str, reason: Reason) -> None:
        """The sentinel does the rest."""
        self._why, self._reason = why, reason
        self._process.kill()

    def _receive(self) -> None:
        connection = self._connection
        if connection is None:
            return
        try:
            message = connection.recv()
        except (EOFError, OSError):
            asyncio.get_running_loop().remove_reader(connection.fileno())
            return
        if isinstance(message, Ready):
            self._disarm()
            if self.given_up:
                self._on_notice(Notice(Severity.NOTICE, "localiser is back", True))
            self.up, self.given_up, self._verified, self._in_vain = True, False, self._stamps, 0
            self.pack_seal = seal(self._stamps) if self._config.map.verify_hashes and self._stamps else ""
            self._report(f"ready: {message.about}" if message.about else "ready")
            if self._started is not None and not self._started.done():
                self._started.set_result(None)
        elif isinstance(message, Failed):
            self._failed(message.error)
        elif isinstance(message, Changed):
            self._on_notice(Notice(Severity.WARNING, "localiser: network on another provider", True, (("now", message.about),)))
        elif isinstance(message, Faulty):
            self._on_notice(
                Notice(Severity.WARNING, "visloc: localiser fails on all frames, see log", True, (("why", message.why),))
            )
        elif self._in_flight is not None and message.request_id == self._in_flight.request_id:
            self._disarm()
            self._in_flight = None
            self._slots.release()
            self.events.put(replace(message, t_rx_ns=self._clock.now_ns()))

    def _failed(self, error: VislocError) -> None:
        self._why, self._unfit = str(error), None if self.up else error
        if self._started is not None and not self._started.done():
            self._started.set_exception(error)

    def _died(self) -> None:
        """The sentinel fired: answer what was asked, report, and start another or give up."""
        if self._connection is not None and self._connection.poll():
            self._receive()  # its last words
        process, connection = self._detach()
        if process is None or connection is None:
            return
        connection.close()
        process.join()
        why = self._why or f"the worker ended with {_exit(process.exitcode)}"
        process.close()
        self.up = False
        if self._in_flight is not None:
            request, self._in_flight = self._in_flight, None
            self._slots.release()
            self._decline(request, self._reason, why)
        if self._started is not None and not self._started.done():
            self._started.set_exception(WorkerError(why, where="worker", remedy="see its messages above"))
        elif self._started is not None and self._started.exception() is None:
            self._in_vain = 0 if self._unfit is None else self._in_vain + 1
            self._restart_or_give_up(why, self._pause_s if self._in_vain else 0.0)

    @property
    def _pause_s(self) -> float:
        """Before the next try where too many have failed; sooner where the last `_in_vain` ones could not open map or network."""
        return min(_VAIN_S * 2.0 ** min(self._in_vain - 1, 16), _PAUSE_S) if self._in_vain else _PAUSE_S

    def _restart_or_give_up(self, why: str, after_s: float = 0.0) -> None:
        now_s = asyncio.get_running_loop().time()
        self._deaths.append(now_s)
        while now_s - self._deaths[0] > _WINDOW_S:
            self._deaths.popleft()
        was_given_up = self.given_up
        self.given_up = was_given_up or len(self._deaths) > self._config.worker.max_restarts
        if self.given_up:
            self._report(f"given up: {why}")
            if not was_given_up:
                what = "map cannot be opened" if self._in_vain and isinstance(self._unfit, MapError) else "localiser failed"
                text = f"{what}, next try in {self._pause_s:.0f} s"
                self._on_notice(Notice(Severity.CRITICAL, text, True, (("why", why),)))
            self._arm(self._pause_s, self._restart)
            return
        self._report(why)
        self._on_notice(Notice(Severity.WARNING, "localiser restarts", False, (("why", why),)))
        if after_s:
            self._arm(after_s, self._restart)
        else:
            self._restart()

    def _restart(self) -> None:
        """Another worker, once the pack's files have been looked at: in a thread, for a medium that hangs must not hold up what
        is sent. One that hangs is waited for, as no worker could open it."""
        self.restarts += 1
        loop, folder = asyncio.get_running_loop(), self._config.map.pack

        def look() -> None:
            stamps = file_stamps(folder)
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(self._restart_with, stamps)

        try:
            threading.Thread(target=look, name="pack", daemon=True).start()
        except RuntimeError as none:  # as for a process below
            self._restart_or_give_up(f"no worker can be started: {none}", _SCARCE_S)
        else:
            self._arm(_LOOK_S, self._hangs)

    def _hangs(self) -> None:
        self._disarm()
        self._report("the map pack's medium does not answer")
        self._on_notice(Notice(Severity.CRITICAL, "map pack's medium hangs", True, (("pack", self._config.map.pack),)))

    def _restart_with(self, stamps: FileStamps) -> None:
        """Hashes are not computed again, unless a file of the pack is not the one that was verified."""
        if self._closed:
            return
        self._stamps = stamps
        verify = self._config.map.verify_hashes and stamps != self._verified
        if verify and stamps:
            self._on_notice(Notice(Severity.WARNING, "the map pack has changed since the start and is verified anew"))
        try:
            self._spawn(self._verifying(verify), _START_S if verify else _RESTART_S)
        except OSError as none:  # what killed the last one may be that no memory is left, nor for another
            self._restart_or_give_up(f"no worker can be started: {none.strerror or none}", _SCARCE_S)

    def _verifying(self, verify: bool) -> Config:
        return self._config.model_copy(update={"map": self._config.map.model_copy(update={"verify_hashes": verify})})

    def _detach(self) -> tuple[Any, Connection | None]:
        """Stop listening to the worker and forget it; its process and connection are the caller's to end."""
        self._disarm()
        process, connection = self._process, self._connection
        self._process = self._connection = None
        loop = asyncio.get_running_loop()
        if process is not None:
            loop.remove_reader(process.sentinel)
        if connection is not None:
            loop.remove_reader(connection.fileno())
        return process, connection

    def _report(self, detail: str) -> None:
        self.events.put(WorkerState(self._clock.now_ns(), self.up, len(self._deaths), detail))

    def _decline(self, request: WorkerRequest, reason: Reason, detail: str) -> None:
        self.events.put(no_fix(request, self._config.localiser.method, reason, detail, self._clock.now_ns()))


def file_stamps(folder: str) -> FileStamps:
    """What tells whether files of a folder were replaced or written to: name, inode, size and times of each. That of the last
    change (ctime) is there for who sets the other one back."""
    stamps = []
    with contextlib.suppress(OSError):
        for path in sorted(Path(folder).rglob("*")) if folder else ():
            stat = path.stat()
            stamps.append((str(path), stat.st_ino, stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns))
    return tuple(stamps)


def seal(stamps: FileStamps) -> str:
    """A text that tells stamps from others."""
    return hashlib.sha256(repr(stamps).encode(errors="surrogateescape")).hexdigest()


def _exit(code: int | None) -> str:
    return f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"
