"""Videos that state more frames than they show: one that was cut without being encoded anew, in which the frames from the key
frame before the cut on are there, and one of which a frame was dropped while it was recorded."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import cv2
import numpy as np

_TICKS_AT, _BEGIN_AT = 16, 16
"""Of version 0 boxes, from their names: a track's ticks a second (mdhd), where its first edit begins (elst)."""


def write_cut_video(path: Path, n: int, hidden: int, width: int = 64, height: int = 48) -> None:
    """Grey frames (MPEG-4, ten a second), each 10 brighter than the one before, the first of which are hidden."""
    data = _written(path, "mp4v", n, width, height)
    (ticks,) = struct.unpack_from(">I", data, data.index(b"mdhd") + _TICKS_AT)
    struct.pack_into(">I", data, data.index(b"elst") + _BEGIN_AT, hidden * ticks // 10)
    path.write_bytes(data)


def write_dropping_video(path: Path, n: int, dropped: int, width: int = 64, height: int = 48) -> None:
    """Frames as above (AVI, Motion JPEG), one of which is empty, as grabbers mark what came too late."""
    data = _written(path, "MJPG", n, width, height)
    chunks = [found.start() - 8 for found in re.finditer(b"\xff\xd8\xff", data)]
    at = chunks[dropped]
    (size,) = struct.unpack_from("<I", data, at + 4)
    data[at : at + 16] = b"00dc" + bytes(4) + b"JUNK" + struct.pack("<I", size - 8)
    struct.pack_into("<I", data, data.index(b"idx1") + 8 + 16 * dropped + 12, 0)
    path.write_bytes(data)


def _written(path: Path, codec: str, n: int, width: int, height: int) -> bytearray:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), 10.0, (width, height))
    for k in range(n):
        writer.write(np.full((height, width, 3), 10 * k, np.uint8))
    writer.release()
    return bytearray(path.read_bytes())
