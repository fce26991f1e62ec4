"""A video that asks viewers to turn it, as cameras write that are mounted upside down."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np

_MATRIX_AT = 40
"""Of a version 0 track header, from its name: version and flags, times, number, duration, layer and volume come before."""


def write_upside_down(path: Path, n: int, width: int = 64, height: int = 48) -> None:
    """Frames (MPEG-4) whose upper half is bright and whose lower half is dark as they are stored, to be turned by 180 degrees."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 10.0, (width, height))
    for _ in range(n):
        writer.write(
            np.repeat(np.array([[[200]], [[40]]], np.uint8), height // 2, axis=0).repeat(width, axis=1).repeat(3, axis=2)
        )
    writer.release()
    data = bytearray(path.read_bytes())
    at = data.index(b"tkhd") + 4 + _MATRIX_AT
    assert struct.unpack_from(">5i", data, at) == (0x10000, 0, 0, 0, 0x10000), "the unit matrix"
    struct.pack_into(">5i", data, at, -0x10000, 0, 0, 0, -0x10000)
    path.write_bytes(data)
