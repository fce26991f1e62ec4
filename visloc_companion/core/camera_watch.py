"""Tells the operator once when frames stop, and once when they come again."""

from __future__ import annotations

from visloc_companion.types import Command, Notice, Severity

SILENCE_NS = 2_000_000_000


class CameraWatch:
    """Knows when the last frame arrived."""

    def __init__(self) -> None:
        self._frame_rx_ns: int | None = None
        self._silent = False

    def on_frame(self, t_rx_ns: int) -> list[Command]:
        """A frame arrived."""
        self._frame_rx_ns = t_rx_ns
        was_silent, self._silent = self._silent, False
        return [Notice(Severity.NOTICE, "camera frames are back")] if was_silent else []

    def check(self, now_ns: int) -> list[Command]:
        """What is to be said now."""
        silent = self._frame_rx_ns is not None and now_ns - self._frame_rx_ns > SILENCE_NS
        if not silent or self._silent:
            return []
        self._silent = True
        return [Notice(Severity.WARNING, "visloc: no camera frames", to_operator=True)]
