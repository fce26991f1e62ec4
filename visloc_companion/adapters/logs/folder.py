"""A FLIGHT folder: telemetry.*, camera.toml, frames.csv or video.*, and truth.csv where somebody measured it.

`camera.toml` holds the keys of the configuration's section `camera` and

    time_base = "autopilot_boot"   # t_us counts from the autopilot's boot; or
    time_base = "unix"             # t_us counts from 1970, UTC; or
    time_base = "offset"           # t_us counts from anywhere: boot time = t_us + offset_s
    offset_s = 12.34               # without it the offset is found from how the pictures turn
    video_start_us = 0             # only for a video without frames.csv

The base holds for frames.csv and truth.csv alike.
"""

from __future__ import annotations

import csv
import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from visloc_companion.adapters.logs.frames import FrameSource, open_frames
from visloc_companion.adapters.logs.open import LOG_SUFFIXES, open_log
from visloc_companion.adapters.logs.recording import NS_PER_S, NS_PER_US, Recording
from visloc_companion.config import CameraConfig, parse_config
from visloc_companion.errors import ConfigError, LogError
from visloc_companion.types import GeoPoint

TIME_BASES = ("autopilot_boot", "unix", "offset")
_STATE_IT = "state boot time minus file time in seconds"
_OWN_KEYS = ("time_base", "offset_s", "video_start_us")


@dataclass(frozen=True, slots=True)
class TruthRow:
    """Where the vehicle really was, on the recording's clock."""

    t_ns: int
    place: GeoPoint


@dataclass(frozen=True, slots=True)
class FoundOffset:
    """The recording's time minus the files', found from the pictures, and its 1-sigma."""

    offset_ns: int
    sigma_s: float


FindOffset = Callable[[Recording, FrameSource, CameraConfig], FoundOffset]


@dataclass(slots=True)
class FlightFolder:
    """A flight with what lies beside its telemetry. `boot_from_file_ns` added to a file's time gives the recording's; `found` is
    set where nobody stated that."""

    recording: Recording
    camera: CameraConfig | None
    frames: FrameSource | None
    truth: list[TruthRow]
    boot_from_file_ns: int
    found: FoundOffset | None = None


def open_folder(folder: Path, find_offset: FindOffset | None = None) -> FlightFolder:
    """Open a FLIGHT folder; `find_offset` is asked where the time base is "offset" and none is stated.

    Raises LogError or ConfigError naming the file, what is wrong with it, and the remedy.
    """
    recording = open_log(_telemetry(folder))
    settings = _camera_toml(folder / "camera.toml")
    stated_ns = _boot_from_file_ns(folder / "camera.toml", settings, recording, sought=find_offset is not None)
    camera = None
    if settings:
        section = {key: value for key, value in settings.items() if key not in _OWN_KEYS}
        camera = parse_config({"camera": section}, where=str(folder / "camera.toml")).camera
    frames = open_frames(folder, settings.get("video_start_us"))
    if frames is not None and camera is None:
        raise LogError("is missing beside the frames", where=str(folder / "camera.toml"), remedy="describe the camera there")
    found = None
    if stated_ns is None:
        if frames is None or camera is None or find_offset is None:
            raise LogError("offset_s: cannot be found without frames", where=str(folder), remedy=_STATE_IT)
        found = find_offset(recording, frames, camera)
        stated_ns = found.offset_ns
    return FlightFolder(recording, camera, frames, read_truth(folder / "truth.csv", stated_ns), stated_ns, found)


def _telemetry(folder: Path) -> Path:
    found = sorted(path for path in folder.glob("telemetry.*") if path.suffix.lower() in LOG_SUFFIXES)
    if len(found) != 1:
        names = ", ".join(path.name for path in found) or "none"
        raise LogError(
            f"needs one telemetry file, has {names}",
            where=str(folder),
            remedy="name it telemetry.tlog, telemetry.bin or telemetry.ulg",
        )
    return found[0]


def _camera_toml(path: Path) -> dict[str, Any]:
    if not path.exists():
        return {}
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as why:
        raise ConfigError(f"cannot be read: {why}", where=str(path), remedy="correct the TOML") from why


def _boot_from_file_ns(path: Path, settings: dict[str, Any], recording: Recording, *, sought: bool) -> int | None:
    """None where it is to be found."""
    base = settings.get("time_base", TIME_BASES[0])
    start_us = settings.get("video_start_us")
    if start_us is not None and (not isinstance(start_us, int) or isinstance(start_us, bool)):
        raise ConfigError(f"video_start_us: not a whole number: {start_us!r}", where=str(path), remedy="state microseconds")
    if base == "autopilot_boot":
        return 0
    if base == "unix":
        if recording.unix_minus_boot_ns is None:
            raise LogError(
                "says nothing about UTC", where=str(recording.path), remedy='use time_base = "offset" and offset_s in camera.toml'
            )
        return -recording.unix_minus_boot_ns
    if base == "offset":
        offset_s = settings.get("offset_s")
        if offset_s is None and sought:
            return None
        if not isinstance(offset_s, int | float) or isinstance(offset_s, bool) or not math.isfinite(offset_s):
            raise ConfigError(
                f"offset_s: needed as a number of seconds, got {offset_s!r}",
                where=str(path),
                remedy=_STATE_IT,
            )
        return round(offset_s * NS_PER_S)
    raise ConfigError(f"time_base: {base!r} is unknown", where=str(path), remedy=f"use one of {', '.join(TIME_BASES)}")


def read_truth(path: Path, boot_from_file_ns: int) -> list[TruthRow]:
    """Rows of truth.csv in time order; empty where there is no such file. Raises LogError naming the row and the column."""
    if not path.exists():
        return []
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = list(csv.DictReader(file, skipinitialspace=True))
    except (OSError, UnicodeDecodeError, csv.Error) as why:
        raise LogError(f"cannot be read: {why}", where=str(path), remedy="write UTF-8 CSV") from why
    truth = [_truth_row(path, number + 1, row, boot_from_file_ns) for number, row in enumerate(rows)]
    return sorted(truth, key=lambda row: row.t_ns)


def _truth_row(path: Path, number: int, row: dict[str, str], boot_from_file_ns: int) -> TruthRow:
    values: dict[str, float] = {}
    for name in ("t_us", "lat_deg", "lon_deg", "h_amsl_m"):
        try:
            values[name] = float(row[name])
        except (KeyError, TypeError, ValueError):
            values[name] = math.nan
        if not math.isfinite(values[name]):
            raise LogError(
                "is missing or no number",
                where=f"{path}, row {number}, column {name}",
                remedy="write columns t_us, lat_deg, lon_deg, h_amsl_m",
            )
    place = GeoPoint(values["lat_deg"], values["lon_deg"], values["h_amsl_m"])
    return TruthRow(round(values["t_us"]) * NS_PER_US + boot_from_file_ns, place)
