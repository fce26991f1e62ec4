"""Tells the operator once when frames stop, and once when they come again; once, too, that they come seldom. A picture that is
repeated is no frame.

Nor is one that only its compression tells from the one before (the worker sees that), nor one whose stamp says that it is old, or
still to come: a camera process stamps with another clock than the autopilot's, or sends what has waited in a buffer. Nor is one
that bears the time of the one before.
"""

from __future__ import annotations

from visloc_companion.core.requests import MAX_FRAME_AGE_NS
from visloc_companion.core.terrain.terrain_aiding import METHOD as TERRAIN
from visloc_companion.errors import Reason
from visloc_companion.types import Command, Fix, FrameRef, NoFix, Notice, Severity

SILENCE_NS = 2_000_000_000
FIRST_FRAME_NS = 10_000_000_000
"""A camera that is configured has so long for its first frame once the autopilot is heard, and with it the operator."""
STEADY_NS = 10_000_000_000
SELDOM_GAPS = 2
"""Frames that were missing so often, within STEADY_NS of coming back each time, come seldom, until none was for that long."""
APART_FRAMES = 4
"""Of frames that come seldom at most so many come between two gaps; a camera of which more do comes and goes."""
RARE_NS = 4_000_000_000
"""Frames that come further apart are rare: what waits for the next one waits long."""
FROZEN = "camera picture stands still, unused"
MAX_AHEAD_NS = 1_000_000_000
"""No attitude belongs to a frame that is stamped further ahead of the autopilot's clock. It must not wait for one either: every
frame after it would seem to be an older one."""


class CameraWatch:
    """Knows when the last frame of use arrived. `expected`: a camera is configured."""

    def __init__(self, expected: bool = False) -> None:
        self._expected = expected
        self._since_ns: int | None = None
        self._frame_rx_ns: int | None = None
        self._silent = False
        self._gaps, self._gap_ns = 0, 0
        self._gap_end_ns: int | None = None
        self._since_gap = self._before_gap = 0
        self._seldom = False
        self._checksum: int | None = None
        self._t_boot_ns: int | None = None
        self._stamp_stands = False
        self._age_ns: int | None = None
        self._frozen_ns: int | None = None
        self._told_frozen = False

    @property
    def rare(self) -> bool:
        """Whether the last frame, as some shortly before, came more than RARE_NS after the one before it."""
        apart = self._gaps >= SELDOM_GAPS and self._before_gap <= APART_FRAMES
        return apart and self._gap_end_ns == self._frame_rx_ns and self._gap_ns > RARE_NS

    def is_new(self, frame: FrameRef) -> bool:
        """Whether a frame differs from the one before, and its own stamp, too: of frames that bear one time only the first may
        have been taken then."""
        before, self._checksum = self._checksum, frame.checksum
        stamped_ns, self._t_boot_ns = self._t_boot_ns, frame.t_boot_ns
        if frame.checksum is not None and frame.checksum == before:
            return False
        self._stamp_stands = frame.t_boot_ns is not None and frame.t_boot_ns == stamped_ns
        return not self._stamp_stands

    def on_frame(self, t_rx_ns: int, t_taken_ns: int) -> list[Command] | None:
        """A new frame arrived that was taken then, both on the shell's clock; None where that makes it useless."""
        age_ns = t_rx_ns - t_taken_ns
        if not -MAX_AHEAD_NS <= age_ns <= MAX_FRAME_AGE_NS:
            self._age_ns, self._expected = age_ns, True
            return None
        before_ns, self._frame_rx_ns, self._age_ns = self._frame_rx_ns, t_rx_ns, None
        if before_ns is not None and t_rx_ns - before_ns > SILENCE_NS:
            self._gaps = self._gaps + 1 if self._lately_gone(before_ns) else 1
            self._gap_ns, self._gap_end_ns = t_rx_ns - before_ns, t_rx_ns
            self._before_gap, self._since_gap = self._since_gap, 0
        self._since_gap += 1
        back = self._silent or (self._seldom and not self._lately_gone(t_rx_ns))
        self._silent, self._seldom = False, self._seldom and not back
        return [Notice(Severity.NOTICE, "camera frames are back")] if back else []

    def on_answer(self, answer: Fix | NoFix) -> list[Command]:
        """The worker has looked at a frame: it shows the same as the one before, although the camera moved, or it does not."""
        if answer.method == TERRAIN:
            return []
        if isinstance(answer, NoFix) and answer.reason is Reason.FROZEN:
            self._frozen_ns = answer.t_rx_ns if self._frozen_ns is None else self._frozen_ns
            return []
        was_told, self._frozen_ns, self._told_frozen = self._told_frozen, None, False
        return [Notice(Severity.NOTICE, "camera frames are back")] if was_told else []

    def check(self, now_ns: int, heard: bool = True) -> list[Command]:
        """What is to be said now; `heard`: the autopilot is, which takes it to the operator."""
        if self._since_ns is None and self._expected and heard:
            self._since_ns = now_ns
        if self._frozen_ns is not None and not self._told_frozen and now_ns - self._frozen_ns > SILENCE_NS:
            self._told_frozen = True
            return [Notice(Severity.WARNING, f"visloc: {FROZEN}", to_operator=True)]
        if self._frame_rx_ns is not None:
            silent = now_ns - self._frame_rx_ns > (max(FIRST_FRAME_NS, 2 * self._gap_ns) if self._seldom else SILENCE_NS)
        else:
            silent = self._since_ns is not None and now_ns - self._since_ns > FIRST_FRAME_NS
        if not silent or self._silent:
            return []
        if self._comes_seldom(now_ns):
            self._seldom = True
            how = f"{self._gap_ns * 1e-9:.0f} s apart" if self._since_gap <= APART_FRAMES else "come and go"
            return [Notice(Severity.WARNING, f"visloc: camera frames {how}", to_operator=True)]
        self._silent = True
        return [Notice(Severity.WARNING, f"visloc: {self._trouble}", to_operator=True)]

    def _comes_seldom(self, now_ns: int) -> bool:
        """Whether frames that are missing now were missing twice shortly before: told each time, they would fill the operator's
        list. Of frames that come and are of no use the reason is told instead."""
        of_use = self._age_ns is None and not self._stamp_stands
        return of_use and not self._seldom and self._gaps >= SELDOM_GAPS and self._lately_gone(now_ns)

    def _lately_gone(self, now_ns: int) -> bool:
        """Whether frames were last missed until STEADY_NS before, or later."""
        return self._gap_end_ns is not None and now_ns - self._gap_end_ns <= STEADY_NS

    @property
    def _trouble(self) -> str:
        if self._age_ns is None and self._stamp_stands:
            return "camera stamps stand still, unused"
        if self._age_ns is None:
            return "no new camera frames" if self._frame_rx_ns is not None else "no camera frames yet"
        seconds, way = abs(self._age_ns) * 1e-9, "old" if self._age_ns > 0 else "ahead"
        return f"camera frames {seconds:.0f} s {way}, unused" if seconds < 1e6 else "camera stamps of another clock, unused"
