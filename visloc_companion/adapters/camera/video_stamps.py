"""What a video file says of the times of its frames."""

from __future__ import annotations

from pathlib import Path

import cv2

RAW_SUFFIXES = (".mjpeg", ".mjpg", ".h264", ".264", ".h265", ".265", ".hevc")
"""Bare streams, without a word of when their frames were taken: decoders make a rate of 25 Hz up."""
VIDEO_SUFFIXES = (
    *(".mp4", ".mkv", ".avi", ".mov", ".webm", ".m4v", ".mpg", ".mpeg", ".ts", ".mts", ".m2ts", ".3gp", ".wmv", ".asf", ".flv"),
    *RAW_SUFFIXES,
)
"""What is taken for a video by its name, in letters of any size."""


def is_raw(video: Path) -> bool:
    """Whether it is a bare stream, which has no times of its own."""
    return video.suffix.lower() in RAW_SUFFIXES


def frame_count(video: Path, expected: int) -> int:
    """How many frames it shows: counted, which takes decoding it, unless it states as many as are expected, holds as many and
    ends with the last of these.

    An AVI states frames, too, that were dropped while it was recorded, and what was cut without being encoded anew those that lie
    before its beginning and are not shown.
    """
    capture = cv2.VideoCapture(str(video))
    stated = round(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    if stated == expected == _packets(video):
        capture.set(cv2.CAP_PROP_POS_FRAMES, expected - 1)
        if capture.grab() and not capture.grab():
            return expected
    return len(stamps_us(video)[0])


def _packets(video: Path) -> int:
    """How many pieces, of a frame each in most formats, its stream has."""
    stream, number = cv2.VideoCapture(str(video), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1]), 0
    while stream.grab():
        number += 1
    stream.release()
    return number


def not_shown(video: Path, n_shown: int) -> int:
    """How many frames its stream holds beyond those that it shows: what follows on damage, most of all, for decoding ends there.

    None of a stream of two fields a frame; it is looked through only where it states another number of frames than it shows.
    """
    if round(cv2.VideoCapture(str(video)).get(cv2.CAP_PROP_FRAME_COUNT)) == n_shown:
        return 0
    n_held = _packets(video)
    of_fields = abs(n_held - 2 * n_shown) <= 0.02 * n_held
    return 0 if of_fields else max(0, n_held - n_shown)


def stamps_us(video: Path) -> tuple[list[int], float]:
    """When each frame is shown, microseconds (cameras record at a rate that varies with the light), and the rate, Hz."""
    capture = cv2.VideoCapture(str(video))
    rate_hz, shown_us = float(capture.get(cv2.CAP_PROP_FPS)), []
    while capture.grab():
        shown_us.append(round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e3))
    capture.release()
    return shown_us, rate_hz
