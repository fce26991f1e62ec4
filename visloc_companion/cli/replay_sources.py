"""What `visloc replay` reads: logs and folders that are flown through a new navigator, and journals that are compared."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from visloc_companion.adapters.camera.calibration import camera_model
from visloc_companion.adapters.logs.folder import FlightFolder, FoundOffset, open_folder
from visloc_companion.adapters.logs.frames import FrameSource
from visloc_companion.adapters.logs.open import open_log
from visloc_companion.adapters.logs.recording import Recording, lacking
from visloc_companion.adapters.logs.truth import TruthRow
from visloc_companion.app.ground_check import ground_of
from visloc_companion.app.journal import Entry
from visloc_companion.app.salvage import MAGIC
from visloc_companion.app.settings import core_settings, mounting
from visloc_companion.app.terrain import TerrainAnswer, configured_terrain
from visloc_companion.cli.journal_source import JournalSource
from visloc_companion.cli.progress import bar
from visloc_companion.cli.rerun_source import RerunSource
from visloc_companion.config import Config, load_config
from visloc_companion.config_camera import CameraConfig
from visloc_companion.errors import ConfigError, LogError, stated_in
from visloc_companion.evaluate.flight import Pace, RecordedEyes, replay_recording
from visloc_companion.evaluate.gate import Check
from visloc_companion.evaluate.record import MAX_TRUTH_GAP_S, FlightRecord, from_entries
from visloc_companion.evaluate.reports.report_map import MapImage
from visloc_companion.evaluate.right_place import check_places
from visloc_companion.evaluate.told import Told
from visloc_companion.evaluate.trusted_gnss import far_from_truth_noted, rare_reports_noted
from visloc_companion.evaluate.unasked import unasked_noted
from visloc_companion.maps.pack import PackMap
from visloc_companion.maps.signature import public_keys
from visloc_companion.types import CameraModel

Latency = Literal["arrival", "computation"]


class Source(Protocol):
    """A flight that can be replayed. `latency` says which of the times that answers took is meaningful."""

    latency: Latency

    def record(self) -> FlightRecord:
        """Replay it."""

    def facts(self) -> dict[str, Any]:
        """More of the result, after `record`."""

    def notes(self) -> list[str]:
        """Sentences for the terminal and the report, after `record`."""

    def checks(self) -> list[Check]:
        """What must hold besides the gate, after `record`."""

    def map_image(self, record: FlightRecord) -> MapImage | None:
        """The ground under the tracks, where a map was given."""


def open_source(
    flight: Path,
    pack: Path | None,
    config: Path | None,
    salvage: bool,
    speed: float | None,
    system_id: int = 0,
    boot: int = 0,
    *,
    rerun: bool = False,
) -> Source:
    """The flight of a path; `system_id`, `boot`: which of several in one log (`open_log`); `rerun`: a journal's frames anew.

    Raises LogError, JournalError, MapError or ConfigError naming what is wrong.
    """
    if not flight.exists():
        raise LogError("is not there", where=str(flight), remedy="name a log, a journal or a folder")
    pace, is_journal = _pace(speed) if speed is not None else None, _is_journal(flight)
    if is_journal and (system_id or boot):
        raise ConfigError("are for logs, not for journals", where="--system-id, --boot", remedy="leave them out")
    stated = load_config(config) if config else None
    if is_journal and rerun:  # opens the pack itself, as the daemon's worker does
        return RerunSource(flight, stated, config or flight, pack, salvage, pace)
    with stated_in(config or flight):
        trusted = public_keys(stated.map.trusted_keys) if stated is not None else ()
    reference = PackMap.open(pack, trusted=trusted) if pack is not None else None
    if is_journal:
        return JournalSource(flight, stated, salvage, reference, pace)
    if rerun:
        raise ConfigError("is for journals", where="--rerun", remedy="leave it out: frames beside a log are localised with --map")
    if salvage:
        raise ConfigError("is for journals", where="--salvage", remedy="leave it out: damage of a log is skipped and counted")
    settings = stated or Config()
    if flight.is_dir():
        folder = open_folder(flight, partial(_find_offset, flight), system_id, boot)
        if folder.camera is not None:
            settings = settings.model_copy(update={"camera": folder.camera})
        places = check_places(folder.recording, folder.truth, flight / "truth.csv", reference)
        return LogSource(folder.recording, settings, reference, pace, folder, place_notes=places)
    recording = open_log(flight, system_id, boot)
    places = check_places(recording, [], flight, reference)
    return LogSource(recording, settings, reference, pace, None, place_notes=places)


def _is_journal(flight: Path) -> bool:
    """By its beginning; a damaged one by its suffix."""
    if flight.suffix.lower() == ".mcap" or not flight.is_file():
        return flight.is_file()
    try:
        with flight.open("rb") as file:
            return file.read(len(MAGIC)) == MAGIC
    except OSError as why:
        raise LogError(f"cannot be read: {why}", where=str(flight), remedy="name a readable file") from why


def _find_offset(folder: Path, recording: Recording, frames: FrameSource, camera: CameraConfig) -> FoundOffset:
    from visloc_companion.evaluate.camera_offset import find_offset

    return find_offset(recording, frames, _model(folder, camera), mounting(camera))


def _model(folder: Path, camera: CameraConfig) -> CameraModel:
    with stated_in(folder / "camera.toml"):
        return camera_model(camera)


def _pace(speed: float) -> Pace:
    started: list[tuple[int, float]] = []

    def wait(t_ns: int) -> None:
        if not started:
            started.append((t_ns, time.monotonic()))
        due = started[0][1] + (t_ns - started[0][0]) / 1e9 / speed
        time.sleep(max(0.0, due - time.monotonic()))

    return wait


@dataclass(slots=True)
class LogSource:
    """A log, alone or in a folder with frames, camera and truth."""

    recording: Recording
    config: Config
    reference: PackMap | None
    pace: Pace | None
    folder: FlightFolder | None
    latency: Latency = "computation"
    place_notes: list[str] = field(default_factory=list)
    flight_notes: list[str] = field(default_factory=list)
    told: Told = field(default_factory=Told)
    changes: dict[str, Any] = field(default_factory=dict)
    truth_share: float = 0.0
    eyes: RecordedEyes | None = None

    def record(self) -> FlightRecord:
        """Fly it through a new navigator."""
        truth: list[TruthRow] = self.folder.truth if self.folder else []
        self.eyes = self._eyes()
        with bar(self.recording.path.name, self.recording.duration_s) as advance:
            entries: Iterable[Entry] = replay_recording(
                self.recording.events,
                core_settings(self.config),
                eyes=self.eyes,
                terrain=self._terrain(),
                ground=None if self.reference is None else ground_of(self.reference),
                on_progress=advance,
                pace=self.pace,
            )
            events = self.recording.events
            record = from_entries(self.told.heard(entries), truth, t0_ns=events[0][0] if events else None)
        self.truth_share = float(np.mean(np.isfinite(record.truth_ned_m[:, 0]))) if len(record.t_s) else 0.0
        self.changes = {"verdicts": record.changes(record.verdicts), "modes": record.changes(record.modes)}
        self.flight_notes = rare_reports_noted(events, self.config.gnss.silence_s) + far_from_truth_noted(record)
        if self.eyes is not None:
            least_m = self.config.navigator.min_height_m
            self.flight_notes += unasked_noted(record.n_frames, record.n_requests, events, least_m)
        return record

    def _eyes(self) -> RecordedEyes | None:
        from visloc_companion.app.localiser import configured_localiser

        if self.folder is None or self.folder.frames is None or self.reference is None:
            return None
        model = _model(self.folder.path, self.config.camera)
        localiser, _ = configured_localiser(self.config.localiser, model)
        return RecordedEyes(self.folder.frames, self.folder.boot_from_file_ns, model, localiser, self.reference)

    def _terrain(self) -> TerrainAnswer | None:
        return None if self.reference is None else configured_terrain(self.config.localiser, self.reference)

    def facts(self) -> dict[str, Any]:
        """The autopilot, what was lost, and the verdicts and modes over time."""
        return {
            "autopilot": str(self.recording.kind),
            "losses": self.recording.losses.as_dict(),
            "origin_inferred": self.recording.origin_inferred,
            **self.changes,
        }

    def notes(self) -> list[str]:
        """What the log lacks."""
        folder = self.folder
        losses = {name: n for name, n in self.recording.losses.as_dict().items() if n and name != "foreign_messages"}
        notes = [f"The log has losses: {', '.join(f'{name} {n}' for name, n in losses.items())}."] if losses else []
        if missing := lacking(self.recording.events):
            notes.append(
                f"The log holds no usable message of: {', '.join(missing)}. Without them little or nothing is estimated."
            )
        notes += [*self.recording.notes, *(folder.notes if folder is not None else ()), *self.place_notes, *self.flight_notes]
        if self.eyes is not None:
            notes += [f"{n} frames that were asked for are no use: {why}." for why, n in self.eyes.unusable.items()]
        if folder is not None and folder.truth and self.truth_share < 0.95:
            notes.append(
                f"Truth is known at {self.truth_share:.0%} of the epochs; gaps beyond {MAX_TRUTH_GAP_S:g} s are not bridged."
            )
        found = None if folder is None else folder.found
        if found is not None:
            offset_s = found.offset_ns / 1e9
            notes.append(f"The frames' clock was found: boot time = t_us + {offset_s:.3f} s, 1-sigma {found.sigma_s:.3f} s.")
        if self.recording.origin_inferred:
            notes.append("The log states no EKF origin; it was inferred from the positions.")
        has_frames = folder is not None and folder.frames is not None
        if has_frames and self.reference is None:
            notes.append("Frames are there, but no --map: they were not localised.")
        if self.reference is not None and not has_frames and not self.config.localiser.terrain:
            notes.append("A map was given, but the flight has no frames: nothing was localised.")
        start_ns = self.recording.events[0][0] if self.recording.events else 0
        return [*notes, *self.told.sentences(start_ns)]

    def checks(self) -> list[Check]:
        """Nothing besides the gate."""
        return []

    def map_image(self, record: FlightRecord) -> MapImage | None:
        """The pack's ortho under the tracks."""
        from visloc_companion.evaluate.map_image import map_image

        return map_image(self.reference, record) if self.reference is not None else None
