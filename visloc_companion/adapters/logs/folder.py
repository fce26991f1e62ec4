"""A FLIGHT folder: telemetry.*, camera.toml, frames.csv or video.*, and truth.csv where somebody measured it.

`camera.toml` holds the keys of the configuration's section `camera`, with frames its size and its lens at least, and

    time_base = "autopilot_boot"   # t_us counts from the autopilot's boot; or
    time_base = "unix"             # t_us counts from 1970, UTC; or
    time_base = "offset"           # t_us counts from anywhere: boot time = t_us + offset_s
    offset_s = 12.34               # without it the offset is found from how the pictures turn
    video_start_us = 0             # only for a video without frames.csv

The base holds for frames.csv and truth.csv alike.
"""

from __future__ import annotations

import bisect
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from visloc_companion.adapters.camera.table import TIME_BASES, require_name, unheaded
from visloc_companion.adapters.logs.frames import FrameSource, files_named, notes_on, open_frames
from visloc_companion.adapters.logs.open import LOG_SUFFIXES, open_log
from visloc_companion.adapters.logs.recording import NS_PER_S, NS_PER_US, Recording
from visloc_companion.adapters.logs.truth import TruthRow, read_truth
from visloc_companion.adapters.table import torn
from visloc_companion.config import mask_found, parse_config
from visloc_companion.config_camera import LENS_KEYS, CameraConfig
from visloc_companion.errors import ConfigError, LogError

_STATE_IT = "state boot time minus file time in seconds"
_STATION = (
    "The log does not state UTC by a satellite receiver: the ground station's clock was taken for it, which may err by seconds."
)
_CLOCKS_AGREE_S, _SIGMAS = 0.1, 5.0
"""What a clock and the turns of pictures may differ by, at least, and in 1-sigmas of the latter: less is found in flight, too."""
_MAX_OFFSET_S = 1e10
_WEEKS_NS = 1024 * 604_800 * NS_PER_S
"""GPS counts weeks in ten bits: receivers that were not told of it lie so far, or a multiple of it, in the past."""
_OWN_KEYS = ("time_base", "offset_s", "video_start_us")


@dataclass(frozen=True, slots=True)
class FoundOffset:
    """The recording's time minus the files', found from the pictures, and its 1-sigma."""

    offset_ns: int
    sigma_s: float


FindOffset = Callable[[Recording, FrameSource, CameraConfig], FoundOffset]


@dataclass(slots=True)
class FlightFolder:
    """A flight with what lies beside its telemetry in the folder `path`. `boot_from_file_ns` added to a file's time gives the
    recording's; `found` is set where nobody stated that. `notes` tell in sentences what of it is of no use."""

    path: Path
    recording: Recording
    camera: CameraConfig | None
    frames: FrameSource | None
    truth: list[TruthRow]
    boot_from_file_ns: int
    found: FoundOffset | None = None
    notes: tuple[str, ...] = ()


def open_folder(folder: Path, find_offset: FindOffset | None = None, system_id: int = 0, boot: int = 0) -> FlightFolder:
    """Open a FLIGHT folder; `find_offset` is asked where the time base is "offset" and none is stated, and where a ground
    station's clock had to be taken for UTC. The rest: `open_log`.

    Raises LogError or ConfigError naming the file, what is wrong with it, and the remedy.
    """
    recording = open_log(_telemetry(folder), system_id, boot)
    for name in ("camera.toml", "truth.csv"):
        require_name(folder / name, LogError)
    settings = _camera_toml(folder / "camera.toml")
    stated_ns = _boot_from_file_ns(folder / "camera.toml", settings, recording, sought=find_offset is not None)
    camera = None
    if settings:
        section = {key: value for key, value in settings.items() if key not in _OWN_KEYS}
        camera = mask_found(parse_config({"camera": section}, where=str(folder / "camera.toml")).camera, folder / "camera.toml")
    frames = open_frames(folder, settings.get("video_start_us"))
    if frames is not None and camera is None:
        what = "states nothing" if (folder / "camera.toml").exists() else "is missing beside the frames"
        raise LogError(what, where=str(folder / "camera.toml"), remedy="describe the camera there")
    if frames is not None and (unsaid := [key for key in LENS_KEYS if key not in settings]):
        what = f"does not say {', '.join(unsaid)}"
        raise ConfigError(
            what, where=str(folder / "camera.toml"), remedy="write the calibration's values (visloc calibrate): none is assumed"
        )
    of_frames = notes_on(frames, folder / "frames.csv")
    found = None
    if stated_ns is None:
        if frames is None or camera is None or find_offset is None:
            raise LogError("offset_s: cannot be found without frames", where=str(folder), remedy=_STATE_IT)
        if camera.mount == "gimbal":
            why = "offset_s: cannot be found from the turns of a camera on a gimbal, which are not the vehicle's"
            raise LogError(why, where=str(folder / "camera.toml"), remedy=_STATE_IT)
        found = find_offset(recording, frames, camera)
        stated_ns = found.offset_ns
    of_station = settings.get("time_base") == "unix" and recording.utc_of_station
    truth = read_truth(folder / "truth.csv", stated_ns)
    frames_ns = [t_us * NS_PER_US + stated_ns for t_us in frames.t_us] if frames is not None else []
    notes = (
        *(_station_judged(stated_ns, recording, frames, camera, find_offset) if of_station else ()),
        *_starts_noted(settings, recording, any_times=bool(frames_ns or truth)),
        *of_frames,
        *torn(folder / "frames.csv"),
        *torn(folder / "truth.csv"),
        *_outside(folder, "frames", frames_ns, recording, stated_ns),
        *_outside(folder, "rows of truth.csv", [row.t_ns for row in truth], recording, stated_ns),
    )
    return FlightFolder(folder, recording, camera, frames, _about(truth, recording), stated_ns, found, notes)


def _starts_noted(settings: dict[str, Any], recording: Recording, *, any_times: bool) -> list[str]:
    """A sentence where the autopilot started more than once: the clock of each start begins at zero."""
    if not (any_times and recording.losses.reboots and settings.get("time_base", TIME_BASES[0]) == TIME_BASES[0]):
        return []
    return [
        "WARNING: the autopilot started more than once in this log, and t_us counts from the first start that was read: frames "
        'and truth that count from another lie at wrong times. Write them in UTC (time_base = "unix"), or those of one start.'
    ]


def _station_judged(
    stated_ns: int, recording: Recording, frames: FrameSource | None, camera: CameraConfig | None, find_offset: FindOffset | None
) -> list[str]:
    """Sentences on a ground station's clock that was taken for UTC, with what the pictures' turns say of it where they do."""
    if frames is None or camera is None or find_offset is None or camera.mount == "gimbal":
        return [_STATION]
    try:
        found = find_offset(recording, frames, camera)
    except LogError:
        return [_STATION, "Whether it does could not be told from how the pictures turn."]
    ahead_s = (found.offset_ns - stated_ns) / NS_PER_S
    if abs(ahead_s) <= max(_CLOCKS_AGREE_S, _SIGMAS * found.sigma_s):
        return [_STATION, f"The pictures turn as the log says to {abs(ahead_s):.2f} s, 1-sigma {found.sigma_s:.2f} s."]
    way = "ahead" if ahead_s > 0 else "behind"
    off = f"that clock was {abs(ahead_s):.2f} s {way} of theirs (1-sigma {found.sigma_s:.2f} s)"
    write = f'write time_base = "offset" and offset_s = {found.offset_ns / NS_PER_S:.3f} into camera.toml'
    return [
        _STATION,
        f"WARNING: by how the pictures turn, {off}, and fixes lie off by the way flown in that time: {write}.",
    ]


def _about(truth: list[TruthRow], recording: Recording) -> list[TruthRow]:
    """The rows within the telemetry, and one before and after, between which the truth at its ends is interpolated."""
    first = bisect.bisect_left(truth, recording.events[0][0], key=lambda row: row.t_ns)
    after = bisect.bisect_right(truth, recording.events[-1][0], key=lambda row: row.t_ns)
    return truth[max(first - 1, 0) : after + 1]


def _outside(folder: Path, what: str, times_ns: Sequence[int], recording: Recording, boot_from_file_ns: int) -> list[str]:
    """Says how many of these times lie outside of the telemetry. Raises LogError where all do: their time base is another one,
    or the receiver counts its weeks anew.
    """
    first_ns, last_ns = recording.events[0][0], recording.events[-1][0]
    n_outside = sum(not first_ns <= t_ns <= last_ns for t_ns in times_ns)
    if not n_outside:
        return []
    if n_outside == len(times_ns):
        told = (
            f"none of the {what} lies in the telemetry, which goes from {first_ns / NS_PER_S:.3f} to {last_ns / NS_PER_S:.3f} s; "
            f"they go from {min(times_ns) / NS_PER_S:.3f} to {max(times_ns) / NS_PER_S:.3f} s on its clock"
        )
        remedy = "write t_us in microseconds and state their time_base in camera.toml"
        cycles = round((times_ns[len(times_ns) // 2] - (first_ns + last_ns) // 2) / _WEEKS_NS)
        if cycles and any(first_ns <= t_ns - cycles * _WEEKS_NS <= last_ns for t_ns in times_ns):
            told += f": {1024 * cycles} weeks off, as of a receiver whose count of weeks, which has ten bits, began anew"
            stated = f"offset_s = {(boot_from_file_ns - cycles * _WEEKS_NS) / NS_PER_S:.3f}"
            remedy = f'write time_base = "offset" and {stated} into camera.toml'
        if others := [note.rstrip(".") for note in recording.notes if "--boot" in note]:  # they may be of another one
            told, remedy = f"{told}. {others[0]}", f"name their boot with --boot; or {remedy}"
        raise LogError(told, where=str(folder), remedy=remedy)
    return [f"Of {len(times_ns)} {what}, {n_outside} lie outside of the telemetry and were left out."]


def _telemetry(folder: Path) -> Path:
    found = files_named(folder, "telemetry", LOG_SUFFIXES)
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
        return unheaded(tomllib.loads(path.read_text(encoding="utf-8-sig")))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as why:
        raise ConfigError(f"cannot be read: {why}", where=str(path), remedy="correct the TOML") from why


def _boot_from_file_ns(path: Path, settings: dict[str, Any], recording: Recording, *, sought: bool) -> int | None:
    """None where it is to be found."""
    base = settings.get("time_base", TIME_BASES[0])
    start_us = settings.get("video_start_us")
    if start_us is not None and (not isinstance(start_us, int) or isinstance(start_us, bool)):
        raise ConfigError(f"video_start_us: not a whole number: {start_us!r}", where=str(path), remedy="state microseconds")
    if "offset_s" in settings and base != "offset":
        raise ConfigError(
            f"offset_s: means nothing with time_base {base!r}",
            where=str(path),
            remedy='set time_base = "offset", or leave it out',
        )
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
        if not isinstance(offset_s, int | float) or isinstance(offset_s, bool) or not abs(offset_s) <= _MAX_OFFSET_S:
            raise ConfigError(
                f"offset_s: needed as a number of seconds, got {offset_s!r}",
                where=str(path),
                remedy=_STATE_IT,
            )
        return round(offset_s * NS_PER_S)
    raise ConfigError(f"time_base: {base!r} is unknown", where=str(path), remedy=f"use one of {', '.join(TIME_BASES)}")
