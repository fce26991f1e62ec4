"""Tells the operator once when a gimbal does not say where it points (or not of the time of frames), or looks away from the
ground, and once when it is over."""

from __future__ import annotations

from collections import deque

from visloc_companion.errors import Reason
from visloc_companion.types import Command, Notice, Severity

GRACE_NS = 3_000_000_000
"""A link that breaks for a moment, and a look to the side and back, are no news."""
PAUSE_NS = 2_000_000_000
"""Frames that are so far apart say nothing of what was between them."""

JUDGED, MOST_UNKNOWN, FEW_UNKNOWN = 20, 10, 2
"""Of so many frames in a row: as many whose time the gimbal's word does not reach are told, as few are none to speak of."""
LATELY_NS = 1_500_000_000
"""Frames count while it was heard so lately: else it may be silent, which is told by itself."""


class GimbalWatch:
    """`heard` and `judged` take what happens, `check` says what there is to say at a Tick."""

    def __init__(self) -> None:
        self._heard_ns: int | None = None
        self._silent = False
        self._away_since_ns: int | None = None
        self._judged_ns = 0
        self._reason = Reason.HORIZON_IN_VIEW
        self._away_told: Severity | None = None
        self._unknown: deque[bool] = deque(maxlen=JUDGED)
        self._unknown_told, self._frame_ns = False, -1

    def heard(self, now_ns: int) -> None:
        """An attitude of the gimbal that is of use arrived."""
        self._heard_ns = now_ns

    def judged(self, reason: Reason | None, now_ns: int, frame_ns: int | None = None) -> None:
        """A frame, of a time by which it is known again, is of use (None), or not (yet), because of the gimbal."""
        frame_ns = now_ns if frame_ns is None else frame_ns
        if self._heard_ns is not None and now_ns - self._heard_ns <= LATELY_NS:
            if frame_ns == self._frame_ns and self._unknown:
                self._unknown.pop()
            self._frame_ns = frame_ns
            self._unknown.append(reason is Reason.NO_GIMBAL_ATTITUDE)
        if reason is Reason.NO_GIMBAL_ATTITUDE:
            return
        if reason is None or now_ns - self._judged_ns > PAUSE_NS:
            self._away_since_ns = None
        self._judged_ns = now_ns
        if reason is not None:
            self._reason = reason
            self._away_since_ns = now_ns if self._away_since_ns is None else self._away_since_ns

    def check(self, now_ns: int, *, heard: bool, needed: bool) -> list[Command]:
        """What is to be said now. `heard`: the autopilot is; `needed`: it flies on our positions."""
        if not heard:
            return []
        return [*self._of_silence(now_ns), *self._of_gaps(), *self._of_looking_away(now_ns, needed)]

    def _of_silence(self, now_ns: int) -> list[Command]:
        if self._heard_ns is None:
            self._heard_ns = now_ns
        was_silent, self._silent = self._silent, now_ns - self._heard_ns > GRACE_NS
        if self._silent and not was_silent:
            data = (("reason", Reason.NO_GIMBAL_ATTITUDE.value),)
            return [Notice(Severity.WARNING, "visloc: no gimbal attitude", to_operator=True, data=data)]
        back = was_silent and not self._silent
        return [Notice(Severity.NOTICE, "visloc: gimbal attitude is back", to_operator=True)] if back else []

    def _of_gaps(self) -> list[Command]:
        """Its word comes, but too rarely or too late for the frames; while it is silent there is nothing to add."""
        if self._silent:
            self._unknown.clear()
        n_unknown = sum(self._unknown)
        if len(self._unknown) < JUDGED or FEW_UNKNOWN < n_unknown < MOST_UNKNOWN:
            return []
        was_told, self._unknown_told = self._unknown_told, n_unknown >= MOST_UNKNOWN
        if self._unknown_told is was_told:
            return []
        if was_told:
            return [Notice(Severity.NOTICE, "visloc: gimbal attitude comes in time again", to_operator=True)]
        data = (("reason", Reason.NO_GIMBAL_ATTITUDE.value), ("frames", float(JUDGED)), ("unknown", float(n_unknown)))
        return [Notice(Severity.WARNING, "visloc: gimbal attitude too rare or late", to_operator=True, data=data)]

    def _of_looking_away(self, now_ns: int, needed: bool) -> list[Command]:
        """Said again, as a warning, when positions begin to be needed meanwhile."""
        away = self._away_since_ns is not None and now_ns - self._away_since_ns > GRACE_NS
        severity = Severity.WARNING if needed else Severity.NOTICE
        if away and self._away_told in (None, Severity.NOTICE) and severity is not self._away_told:
            self._away_told = severity
            data = (("reason", self._reason.value),)
            return [Notice(severity, "visloc: gimbal looks away from the ground", to_operator=True, data=data)]
        if self._away_since_ns is None and self._away_told is not None:
            self._away_told = None
            return [Notice(Severity.NOTICE, "visloc: gimbal looks at the ground again", to_operator=True)]
        return []
