"""A video whose frames are shown at given times, as cameras record whose rate varies with the light."""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np


def write_varying_video(path: Path, shown_ms: Sequence[int], width: int = 64, height: int = 48) -> None:
    """Grey frames (40 brighter each) in Matroska; the milliseconds of its SimpleBlocks are rewritten."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 10.0, (width, height))
    for k in range(len(shown_ms)):
        writer.write(np.full((height, width, 3), 40 * k, np.uint8))
    writer.release()
    data = bytearray(path.read_bytes())
    blocks = [found.start(1) for found in re.finditer(rb"\xa3.\x81(..)[\x00\x80]\x00\x00\x01", data, re.DOTALL)]
    assert len(blocks) == len(shown_ms), "SimpleBlocks of Matroska: size, track, milliseconds (16 bits), flags"
    for at, t_ms in zip(blocks, shown_ms, strict=True):
        struct.pack_into(">h", data, at, t_ms)
    path.write_bytes(data)
