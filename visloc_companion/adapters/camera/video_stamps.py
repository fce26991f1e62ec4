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
    """How many frames it has: counted where what it states is not what is expected."""
    stated = round(cv2.VideoCapture(str(video)).get(cv2.CAP_PROP_FRAME_COUNT))
    return expected if stated == expected else len(stamps_us(video)[0])


def stamps_us(video: Path) -> tuple[list[int], float]:
    """When each frame is shown, microseconds (cameras record at a rate that varies with the light), and the rate, Hz."""
    capture = cv2.VideoCapture(str(video))
    rate_hz, shown_us = float(capture.get(cv2.CAP_PROP_FPS)), []
    while capture.grab():
        shown_us.append(round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e3))
    capture.release()
    return shown_us, rate_hz
