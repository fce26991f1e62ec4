"""Opens a recorded flight, whatever wrote it: by what the file begins with, then by its suffix."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

from visloc_companion.adapters.logs.dataflash import read_dataflash
from visloc_companion.adapters.logs.recording import Recording, with_origin
from visloc_companion.adapters.logs.tlog import packet_length, read_tlog
from visloc_companion.adapters.logs.ulog import read_ulog
from visloc_companion.errors import LogError

_Reader = Callable[..., Recording]
_BY_SUFFIX: dict[str, _Reader] = {".tlog": read_tlog, ".bin": read_dataflash, ".ulg": read_ulog, ".ulog": read_ulog}
LOG_SUFFIXES = tuple(_BY_SUFFIX)
_COMPRESSED = {
    b"\x1f\x8b\x08": "zcat",
    b"PK\x03\x04": "unzip -p",
    b"BZh": "bzcat",
    b"\xfd7zXZ": "xzcat",
    b"\x28\xb5\x2f\xfd": "zstdcat",
}
"""What a compressed file begins with, and what makes a log of it."""
_OTHERS = {
    b"FMT, ": ("is a text that was made of a .bin", "replay the .bin itself"),
    b"ULogEnc": ("is encrypted", "decrypt it with the key of the aircraft (PX4 has a script for it), and replay the .ulg"),
    b"#ROSBAG": ("is a ROS bag", "replay the autopilot's own log (.bin or .ulg) or the ground station's (.tlog)"),
}
"""What files of other kinds begin with that are taken for logs, and what to do."""
_BARE = "holds MAVLink packets without the times at which they came", "replay the .tlog that the ground station wrote beside it"
_HEAD_BYTES = 600
"""Two of the longest packets."""
_REMEDY = "give a .tlog, .bin or .ulg file, an .mcap journal, or a folder with telemetry.*"


def open_log(path: Path, system_id: int = 0, boot: int = 0) -> Recording:
    """The events of a telemetry log (.tlog), an ArduPilot log (.bin) or a PX4 log (.ulg), with an EKF origin.

    `system_id`: the vehicle of a telemetry log (0: the one whose heartbeats are most); `boot`: which of several boots in one
    on-board log, from 1 (0: the one that tells most). Raises LogError naming the file where it is missing, of another kind, or
    holds no such flight.
    """
    if path.is_fifo():
        raise LogError("is a pipe, and a log is read more than once", where=str(path), remedy="write it into a file first")
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError as why:
        raise LogError(f"cannot be read: {why}", where=str(path), remedy=_REMEDY) from why
    if unpack := next((command for begin, command in _COMPRESSED.items() if head.startswith(begin)), None):
        raise LogError("is compressed", where=str(path), remedy=f"{unpack} {path.name} > LOG, and replay that")
    if other := next((other for begin, other in _OTHERS.items() if head.startswith(begin)), _BARE if _is_bare(head) else None):
        raise LogError(other[0], where=str(path), remedy=other[1])
    reader = _by_content(head) or _BY_SUFFIX.get(path.suffix.lower())
    if reader is None:
        raise LogError(f"is no log that is known (it begins with {head[:8].hex(' ')})", where=str(path), remedy=_REMEDY)
    if system_id and reader is not read_tlog:
        raise LogError("is no telemetry log: it is of one vehicle", where=str(path), remedy="leave --system-id out")
    if boot and reader is read_tlog:
        raise LogError("is a telemetry log: its boots follow each other", where=str(path), remedy="leave --boot out")
    chosen = {"system_id": system_id} if reader is read_tlog else {"boot": boot}
    return with_origin(reader(path, **chosen))


def _is_bare(head: bytes) -> bool:
    """Whether MAVLink packets follow each other without a time in between, as in what Mission Planner calls .rlog."""
    at = 0
    for _ in range(2):
        length = packet_length(head, at)
        if not length:
            return False
        at += length
    return packet_length(head, at) > 0


def _by_content(head: bytes) -> _Reader | None:
    if head.startswith(b"ULog\x01\x12\x35"):
        return read_ulog
    if head.startswith(b"\xa3\x95\x80"):
        return read_dataflash
    if len(head) >= 9 and head[8] in (0xFD, 0xFE) and 10**15 < struct.unpack(">Q", head[:8])[0] < 5 * 10**15:
        return read_tlog
    return None
