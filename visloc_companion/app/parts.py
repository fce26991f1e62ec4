"""Builds the parts of a daemon from a configuration, and collects everything that stands against the start at once."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from visloc_companion.adapters.camera.calibration import camera_model
from visloc_companion.app.ground_check import open_pack
from visloc_companion.app.handover import Handover, Left
from visloc_companion.app.journal import JournalWriter
from visloc_companion.app.journal_folder import delete_outgrown
from visloc_companion.app.journal_header import JournalHeader
from visloc_companion.app.slots import SharedFrameSlots
from visloc_companion.app.status import require_nobody, require_status_socket
from visloc_companion.app.versions import versions
from visloc_companion.app.worker import WorkerSupervisor
from visloc_companion.app.worker_ahead import WorkerAhead
from visloc_companion.app.worker_process import REAL_ANSWERS
from visloc_companion.config import Config
from visloc_companion.errors import CameraError, ConfigError, JournalError, MapError, VislocError, is_of_the_disk
from visloc_companion.protocols import AutopilotLink, Camera, Clock
from visloc_companion.types import Event, Notice, Severity

T = TypeVar("T")
MakeLink = Callable[[Config, Clock, Callable[[bytes, int, bool], None], Callable[[str], None], Left | None], AutopilotLink]
MakeCamera = Callable[[Config, Clock], Camera]


@dataclass(frozen=True, slots=True)
class Constructors:
    """What makes the parts that touch the world; tests give others."""

    link: MakeLink
    camera: MakeCamera
    answers: str = REAL_ANSWERS


@dataclass(slots=True)
class Parts:
    """The parts of a running daemon. Without a camera, or terrain to be asked about, there is no worker either; without a folder
    no journal. `heard` are the link's events since it was opened."""

    config: Config
    clock: Clock
    link: AutopilotLink | None = None
    heard: AsyncIterator[Event] | None = None
    slots: SharedFrameSlots | None = None
    camera: Camera | None = None
    worker: WorkerSupervisor | None = None
    journal: JournalWriter | None = None
    handover: Handover = field(init=False)

    def __post_init__(self) -> None:
        self.handover = Handover(self.config.status.socket)

    async def close(self) -> None:
        """Close whatever there is: the link first, so that nothing is sent any more, the journal last."""
        if self.link is not None:
            await self.link.close()
        if self.camera is not None:
            with contextlib.suppress(CameraError):  # it may be what broke
                await self.camera.close()
        if self.worker is not None:
            await self.worker.close()
        if self.slots is not None:
            self.slots.close()
        if self.journal is not None:
            self.journal.close()


class StartFailed(ExceptionGroup[VislocError]):
    """Everything that stands against the start."""


@dataclass(frozen=True, slots=True)
class Reports:
    """Where parts report: notices of the worker, problems of the journal (from its thread), warnings of the link."""

    notice: Callable[[Notice], None]
    journal_problem: Callable[[str], None]
    link_warning: Callable[[str], None]


async def assemble(config: Config, clock: Clock, make: Constructors, reports: Reports, ahead: WorkerAhead | None = None) -> Parts:
    """Build and start all parts; `ahead` waits to be the worker. Raises StartFailed with everything that is wrong, and leaves
    nothing open then."""
    parts = Parts(config, clock)
    try:
        problems = await _build(parts, make, reports, ahead)
        if problems:
            raise StartFailed("visloc cannot start", problems)
    except BaseException:
        await parts.close()
        if parts.journal is not None:
            _discard(parts.journal)
        raise
    return parts


async def _build(parts: Parts, make: Constructors, reports: Reports, ahead: WorkerAhead | None) -> list[VislocError]:
    """Fill in the parts; what stands against them.

    What takes long goes side by side, since a start in flight is time without positions: the worker's process is begun first,
    and while it opens map and network this one imports the link's libraries and is already heard by the autopilot.
    """
    config, clock, left = parts.config, parts.clock, parts.handover.left
    problems: list[VislocError] = []
    if config.status.socket:
        _tried(problems, lambda: require_nobody(Path(config.status.socket)))
        if problems:  # it may be flying: what a worker takes of memory and cores here, it lacks there
            return problems
        _tried(problems, lambda: require_status_socket(Path(config.status.socket)))
    if config.camera.url or config.localiser.terrain:
        _tried(problems, lambda: require_pack(config))
        slots = parts.slots = _tried(problems, lambda: SharedFrameSlots(camera_model(config.camera)))
        if config.map.pack and slots is not None:
            known = "" if left is None else left.pack_seal
            parts.worker = WorkerSupervisor(
                config, slots, clock, on_notice=reports.notice, factory=make.answers, known=known, ahead=ahead
            )
            parts.worker.begin()
    elif config.map.pack and config.map.trusted_keys:  # nobody else verifies what the ground is held against
        await _tried_later(problems, asyncio.to_thread(open_pack, config, verify_hashes=True))
    parts.link = _tried(problems, lambda: make.link(config, clock, _raw_tap(parts), reports.link_warning, left))
    if config.camera.url:
        parts.camera = await _tried_later(problems, asyncio.to_thread(make.camera, config, clock))
        _tried(problems, lambda: check_calibration(config, parts.camera))
        if parts.camera is not None:
            _tried(problems, lambda: require_lens(config))
    if config.journal.folder and not problems:
        if left is None:
            await _make_room(config, reports)
        parts.journal = _tried(problems, lambda: _journal(config, clock, reports.journal_problem))
    elif config.journal.folder:
        _tried(problems, lambda: check_journal_folder(config, leave_folder=True))
    if parts.link is not None and not problems:
        parts.heard = parts.link.events()
    if parts.worker is not None:
        await _tried_later(problems, parts.worker.start())
    return problems


def check_calibration(config: Config, camera: Camera | None) -> None:
    """The camera's own model, where it has one, must be that of the configuration. Raises CameraError."""
    if camera is not None and (found := camera.model()) != (wanted := camera_model(config.camera)):
        size = f"{found.width_px}x{found.height_px}, not {wanted.width_px}x{wanted.height_px}"
        what = size if (found.width_px, found.height_px) != (wanted.width_px, wanted.height_px) else f"{found}, not {wanted}"
        raise CameraError(f"its calibration is {what}", where=config.camera.url, remedy="correct section camera")


def require_lens(config: Config) -> None:
    """A focal length that is assumed gives fixes that are off by as much as it is wrong. Raises ConfigError."""
    if config.camera.unstated:
        raise ConfigError(
            f"{', '.join(config.camera.unstated)} not stated, but camera.url is set",
            where="camera",
            remedy="write the calibration's values: none is assumed (docs/on-a-drone.md, Calibration)",
        )


def require_pack(config: Config) -> bool:
    """Camera and rangefinder are of use only with a map. Raises ConfigError."""
    if not config.map.pack:
        why = "camera.url" if config.camera.url else "localiser.terrain"
        raise ConfigError(f"is empty, but {why} is set", where="map.pack", remedy="name the folder that `visloc map build` made")
    return True


def check_journal_folder(config: Config, *, leave_folder: bool = False) -> None:
    """Make a journal in the journal's folder and remove it. Raises JournalError, also where the disk is full.

    Folders that were not there are not left, unless the daemon itself asks: those of a check by root would keep the daemon's
    own user from writing.
    """
    folder = config.journal.folder
    made = [] if leave_folder else [path for path in (Path(folder), *Path(folder).parents) if not _may_be_there(path)]
    try:
        journal = JournalWriter.create(Path(folder), JournalHeader({}), max_bytes=config.journal.max_bytes)
        _discard(journal)
    finally:
        for path in made:
            with contextlib.suppress(OSError):
                path.rmdir()
    if journal.problem:
        raise JournalError(journal.problem, where=folder, remedy="make room, or name another journal.folder")


def _may_be_there(path: Path) -> bool:
    """Whether it exists, or lies where this user may not look."""
    try:
        return path.exists()
    except OSError:
        return True


def journal_header(config: Config, started_ns: int) -> JournalHeader:
    """What flies from now on, which is `started_ns` on the shell's clock: effective configuration, versions, hash of the map's
    manifest, and by the fingerprint of which trusted key it is signed."""
    digest, signed_by, manifest = "", "", Path(config.map.pack) / "manifest.json"
    with contextlib.suppress(OSError):  # who opens the pack says so
        raw = manifest.read_bytes() if config.map.pack and manifest.is_file() else b""
        digest = hashlib.sha256(raw).hexdigest() if raw else ""
        signed_by = _signed_by(config, raw) if raw and config.map.trusted_keys else ""
    return JournalHeader(config.model_dump(mode="json"), versions(), digest, signed_by, started_ns, time.time_ns())


def _signed_by(config: Config, raw: bytes) -> str:
    from visloc_companion.maps.signature import public_keys, require_signed

    try:
        return require_signed(raw, Path(config.map.pack), public_keys(config.map.trusted_keys))
    except (MapError, ConfigError):  # who opens the pack says so
        return ""


async def _make_room(config: Config, reports: Reports) -> None:
    """On the ground alone: a file of 2 GB took 0.9 s to delete, and a start in flight is time without positions."""
    gone = await asyncio.to_thread(delete_outgrown, Path(config.journal.folder), config.journal.keep_bytes)
    if gone:
        names = " ".join(path.name for path in gone)
        reports.notice(Notice(Severity.INFO, "old journals are deleted (journal.keep_bytes)", data=(("names", names),)))


def _journal(config: Config, clock: Clock, on_problem: Callable[[str], None]) -> JournalWriter | None:
    """None where the disk fails, which may be why the daemon starts again in flight: that is told, and no reason to stay away."""
    header, folder = journal_header(config, clock.now_ns()), Path(config.journal.folder)
    try:
        return JournalWriter.create(folder, header, max_bytes=config.journal.max_bytes, on_problem=on_problem)
    except JournalError as none:
        why = none.__cause__
        if not is_of_the_disk(why):
            raise
        on_problem(f"no journal: {getattr(why, 'strerror', why)}")
        return None


def _discard(journal: JournalWriter) -> None:
    """Leave no file of a start that failed."""
    journal.close()
    if journal.path is not None:
        journal.path.unlink(missing_ok=True)


def _raw_tap(parts: Parts) -> Callable[[bytes, int, bool], None]:
    def tap(data: bytes, t_ns: int, outgoing: bool) -> None:
        if parts.journal is not None:
            parts.journal.mavlink(t_ns, data, outgoing=outgoing)

    return tap


def _tried(problems: list[VislocError], build: Callable[[], T]) -> T | None:
    try:
        return build()
    except VislocError as problem:
        problems.append(problem)
        return None


async def _tried_later(problems: list[VislocError], start: Awaitable[T]) -> T | None:
    try:
        return await start
    except VislocError as problem:
        problems.append(problem)
        return None
