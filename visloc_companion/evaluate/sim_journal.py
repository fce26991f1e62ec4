"""The journal of a simulated flight: what the daemon would have recorded, with the frames that were localised if wished."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from visloc_companion.app.journal import Entry, JournalWriter
from visloc_companion.app.parts import journal_header
from visloc_companion.config import Config, MapConfig
from visloc_companion.config_camera import CameraConfig
from visloc_companion.errors import JournalError
from visloc_companion.sim.flight import CLOCK_OFFSET_NS
from visloc_companion.types import CameraModel, FrameRef, Image

MAX_BYTES = 20_000_000_000
_WAITING = 1000


@dataclass(frozen=True, slots=True)
class JournalChoice:
    """Where a flight's journal goes, and whether the frames that are localised are in it."""

    path: Path
    frames: bool = False


@dataclass(slots=True)
class FlightJournal:
    """Takes a flight's entries, and the pixels of its frames where `frames` is set. Waits for the disk: nothing is dropped."""

    writer: JournalWriter
    frames: bool
    _now_ns: int = CLOCK_OFFSET_NS

    def entry(self, entry: Entry) -> None:
        """Record an event or a command."""
        self._now_ns = entry.now_ns
        self.writer.entry(entry)
        self.writer.wait(_WAITING)

    def pixels(self, frame: FrameRef, pixels: Image) -> None:
        """Record a frame's pixels, (H, W, 3) RGB or (H, W)."""
        if self.frames:
            self.writer.frame(self._now_ns, frame, pixels)
            self.writer.wait(_WAITING)


@contextmanager
def flight_journal(path: Path, config: Config, *, frames: bool) -> Iterator[FlightJournal]:
    """A new journal at a path, closed at the end of the context.

    Raises JournalError where it cannot be written, at the start or (a full disk) at the end of the flight.
    """
    problems: list[str] = []
    try:
        stream = path.open("wb")
    except OSError as why:
        raise _unwritable(path, str(why)) from why
    header = journal_header(config, CLOCK_OFFSET_NS)
    writer = JournalWriter(stream, header, max_bytes=MAX_BYTES, on_problem=problems.append, path=path)
    try:
        yield FlightJournal(writer, frames)
    finally:
        writer.wait(0)
        writer.close()
    if problems or writer.dropped:
        raise _unwritable(path, problems[0] if problems else f"{writer.dropped} records were dropped")


def journalled_config(config: Config, model: CameraModel, pack: Path, method: str) -> Config:
    """What flew, for a journal that is to be flown again: the configuration with the camera, the map and the method."""
    lens = {name: getattr(model, name) for name in CameraConfig.model_fields if hasattr(model, name) and name != "mask"}
    return config.model_copy(
        update={
            "camera": config.camera.model_copy(update=lens),
            "map": MapConfig(pack=str(pack.absolute()), verify_hashes=False),
            "localiser": config.localiser.model_copy(update={"method": method}),
        }
    )


def _unwritable(path: Path, why: str) -> JournalError:
    return JournalError(f"cannot be written: {why}", where=str(path), remedy="name a file in a writable folder with --journal")
