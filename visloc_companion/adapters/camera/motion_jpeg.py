"""Streams of JPEGs (network cameras over HTTP, `.mjpeg`, many `.avi`): each picture at the size at which it came.

OpenCV opens them with FFmpeg and gives every picture the size of the first: one of a camera that changed its size, or was turned
on its side, comes stretched, through a lens that nobody calibrated, and nothing tells.
"""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import VislocError

_FOURCC = int(cv2.VideoWriter.fourcc(*"MJPG"))
_PACKETS = [cv2.CAP_PROP_FORMAT, -1]
"""Has a capture give packets as they are, not what they show."""
_DECODE = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
_START, _SCAN = b"\xff\xd8", 0xDA
_NO_FRAME_HEADERS = (0xC4, 0xC8, 0xCC)
"""Of the markers 0xC0 to 0xCF, all others of which begin a frame and state its size (ITU-T T.81, table B.1)."""


class _Packets(Protocol):
    """What is used of cv2.VideoCapture, which types `read` as of pictures."""

    def read(self) -> tuple[bool, Any]:
        """The next packet, uint8."""

    def release(self) -> None:
        """Close it."""


class MotionJpeg:
    """Reads as cv2.VideoCapture does. `first`: the packet that was read before."""

    def __init__(self, packets: _Packets, first: NDArray[np.uint8]) -> None:
        self._packets = packets
        self._first: NDArray[np.uint8] | None = first

    def read(self) -> tuple[bool, Any]:
        """The next picture, (H, W, 3) BGR, None where its packet holds none. Raises cv2.error for an empty packet."""
        first, self._first = self._first, None
        ok, packet = (True, first) if first is not None else self._packets.read()
        return ok, cv2.imdecode(packet.ravel(), _DECODE) if ok else None

    def release(self) -> None:
        """Close the stream."""
        self._packets.release()


def with_own_sizes(capture: cv2.VideoCapture, source: str) -> cv2.VideoCapture | MotionJpeg:
    """An open capture, or where it is of JPEGs one of the same source that decodes them itself.

    Not for fields of interlaced pictures, two JPEGs a packet: FFmpeg alone weaves them.
    """
    if not _is_of_jpegs(capture):
        return capture
    size = _stated_size(capture)
    capture.release()
    packets = cv2.VideoCapture(source, cv2.CAP_FFMPEG, _PACKETS)
    ok, packet = packets.read() if packets.isOpened() else (False, None)
    if ok and packet is not None and jpeg_size(packet.tobytes()) == size:
        return MotionJpeg(packets, np.asarray(packet, dtype=np.uint8))
    packets.release()
    return cv2.VideoCapture(source)


def require_one_size(video: Path, kind: type[VislocError]) -> None:
    """Raises an error of `kind` for a video of JPEGs of several sizes, naming the first frame that is not as those before."""
    capture = cv2.VideoCapture(str(video))
    if not _is_of_jpegs(capture):
        return
    capture.release()
    packets, before = cv2.VideoCapture(str(video), cv2.CAP_FFMPEG, _PACKETS), None
    for number in count():
        ok, packet = packets.read()
        if not ok:
            return
        size = jpeg_size(packet.tobytes())
        if before is not None and size is not None and size != before:
            (width, height), (width_before, height_before) = size, before
            raise kind(
                f"frame {number} (from 0) is {width}x{height}, those before are {width_before}x{height_before}",
                where=str(video),
                remedy="cut the video where the camera changed, and use the part of the calibrated size",
            )
        before = size or before


def jpeg_size(data: bytes) -> tuple[int, int] | None:
    """(width, height) in pixels that a JPEG states; None where it states none."""
    at = len(_START)
    while data.startswith(_START) and at + 9 <= len(data) and data[at] == 0xFF and data[at + 1] != _SCAN:
        if 0xC0 <= data[at + 1] <= 0xCF and data[at + 1] not in _NO_FRAME_HEADERS:
            return int.from_bytes(data[at + 7 : at + 9], "big"), int.from_bytes(data[at + 5 : at + 7], "big")
        at += 1 if data[at + 1] == 0xFF else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return None


def _is_of_jpegs(capture: cv2.VideoCapture) -> bool:
    return capture.isOpened() and capture.getBackendName() == "FFMPEG" and int(capture.get(cv2.CAP_PROP_FOURCC)) == _FOURCC


def _stated_size(capture: cv2.VideoCapture) -> tuple[int, int]:
    return int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
