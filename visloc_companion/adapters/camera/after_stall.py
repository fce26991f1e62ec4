"""Frames that waited in a buffer while their camera stalled, where nothing but their arrival says when they were taken.

A network camera, a driver or a pipe that was held up gives all at once what it kept meanwhile: each of these frames is late by up
to the whole stall, and looks as if it had just been taken. A frame that had to be waited for was not kept by anybody. What comes
at twice the camera's rate and more is given in less time than was kept: a camera that goes on at such a rate takes it by now.
"""

from __future__ import annotations

WAITED = "waited in a buffer while the camera stalled"
LEAST_STALL_S, STALL_PERIODS = 0.25, 3.0
"""A gap is a stall from so many seconds and so many periods on: shorter ones are jitter, which the frames' even clock takes out
(core/camera/frame_clock.py), or a lost frame or two."""
WAITED_PERIODS = 0.5
"""A frame that comes so long after the one before was waited for."""
GAPS = 8
"""The period is the mean of about so many gaps."""


class AfterStall:
    """Tells which frames are as fresh as they seem, by their arrivals alone."""

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._period_s = 0.0
        self._stalled = False
        self._kept_until_ns = 0

    def is_fresh(self, arrival_ns: int) -> bool:
        """Whether the next frame is; after a stall the first that is had to be waited for."""
        last_ns, self._last_ns = self._last_ns, arrival_ns
        if last_ns is None:
            return True
        gap_s = (arrival_ns - last_ns) * 1e-9
        if self._stalled:
            self._stalled = gap_s < WAITED_PERIODS * self._period_s
            if self._stalled and arrival_ns > self._kept_until_ns:
                self._stalled, self._period_s = False, gap_s  # the camera is faster by now
        else:
            self._stalled = self._period_s > 0 and gap_s > max(LEAST_STALL_S, STALL_PERIODS * self._period_s)
            self._kept_until_ns = 2 * arrival_ns - last_ns
        if not self._stalled:
            self._period_s += (gap_s - self._period_s) / (GAPS if self._period_s > 0 else 1)
        return not self._stalled
