"""Tells the operator once when frames stop, and once when they come again. A picture that is repeated is no frame."""

from __future__ import annotations

from visloc_companion.types import Command, FrameRef, Notice, Severity

SILENCE_NS = 2_000_000_000


class CameraWatch:
    """Knows when the last frame arrived."""

    def __init__(self) -> None:
        self._frame_rx_ns: int | None = None
        self._silent = False
        self._checksum: int | None = None

    def is_new(self, frame: FrameRef) -> bool:
        """Whether a frame differs from the one before."""
        before, self._checksum = self._checksum, frame.checksum
        return frame.checksum is None or frame.checksum != before

    def on_frame(self, t_rx_ns: int) -> list[Command]:
        """A new frame arrived."""
        self._frame_rx_ns = t_rx_ns
        was_silent, self._silent = self._silent, False
        return [Notice(Severity.NOTICE, "camera frames are back")] if was_silent else []

    def check(self, now_ns: int) -> list[Command]:
        """What is to be said now."""
        silent = self._frame_rx_ns is not None and now_ns - self._frame_rx_ns > SILENCE_NS
        if not silent or self._silent:
            return []
        self._silent = True
        return [Notice(Severity.WARNING, "visloc: no new camera frames", to_operator=True)]
