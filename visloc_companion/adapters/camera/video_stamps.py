"""What a video file says of the times of its frames."""

from __future__ import annotations

from pathlib import Path

import cv2


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
