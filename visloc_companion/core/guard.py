"""The core's own time, which never goes back, and notices that do not repeat themselves."""

from __future__ import annotations

import math
from enum import Enum

from visloc_companion.core.validate import MAX_SIGMA_M
from visloc_companion.errors import Reason
from visloc_companion.types import Event, Fix, Notice, Severity

TOLERATED_NS = 1_000_000_000
STEP_NS = 50_000_000
STEP_EVENTS = 5
"""Events may overtake each other by so much; so many in a row further back mean that the clock itself stepped."""
RESTART_AFTER = 20
LEAP_NS, LEAP_AGE_NS = 400_000_000, 5_000_000_000
"""A time without any event that may have been a step forward, at least; and for how long it may explain a step of the clocks'
offset, which it exceeds by the usual time between events, at most LEAP_NS."""
REPEAT_NS = 10_000_000_000


class TimeCheck(Enum):
    """What to do with an event, judged by the time that came with it."""

    FINE = "fine"
    BEHIND = "behind"
    DROP = "drop"
    RESTART = "restart"


class TimeGuard:
    """Watches the shell's monotonic clock.

    Small steps back are clamped, and the core's time stands until the clock has caught up. An event far in the past is dropped;
    RESTART_AFTER of them in a row mean that the clock itself was set back (another recording, a simulator that began anew), and
    nothing that is remembered has a time any more.
    """

    def __init__(self) -> None:
        self.now_ns: int | None = None
        self._n_back = self._n_behind = self._behind_ns = 0
        self._gap_ns = (0, 0)

    def check(self, now_ns: int) -> TimeCheck:
        """Judge and remember a time."""
        back_ns = 0 if self.now_ns is None else self.now_ns - now_ns
        if -LEAP_NS < back_ns <= 0:  # nearly all
            self._n_back, self.now_ns = 0, now_ns
            return TimeCheck.FINE
        if back_ns > TOLERATED_NS:
            self._n_back += 1
            return TimeCheck.RESTART if self._n_back >= RESTART_AFTER else TimeCheck.DROP
        self._n_back = 0
        if back_ns > (0 if self._n_behind else STEP_NS):
            self._n_behind, self._behind_ns = self._n_behind + 1, max(self._behind_ns, back_ns)
            return TimeCheck.BEHIND
        if self.now_ns is not None and -back_ns >= LEAP_NS:
            self._gap_ns = (self.now_ns, now_ns)
        self.now_ns = now_ns if self.now_ns is None else max(self.now_ns, now_ns)
        return TimeCheck.FINE

    def leapt_since_ns(self, step_ns: int) -> int | None:
        """The last time before a step of the clocks' offset, where it is this clock that stepped: lately nothing happened on it
        for as long. A step of the other clock leaves no such gap, a process that was held no step."""
        began_ns, ended_ns = self._gap_ns
        recent = self.now_ns is not None and self.now_ns - ended_ns <= LEAP_AGE_NS
        fits = -STEP_NS <= ended_ns - began_ns - step_ns <= LEAP_NS
        return began_ns if recent and fits else None

    def stood_ns(self) -> int:
        """For how long the core's time stood while a clock that had stepped back caught up; asked when it has, told once."""
        if not self._n_behind:
            return 0
        stood_ns = self._behind_ns if self._n_behind >= STEP_EVENTS else 0
        self._n_behind = self._behind_ns = 0
        return stood_ns


NO_POLES = "visloc: beyond 89 deg of latitude, NO POSITION"


class Complaints:
    """Notices about bad input, at most one for each kind and reason in REPEAT_NS."""

    def __init__(self) -> None:
        self._last_ns: dict[tuple[str, Reason], int] = {}

    def about(self, event: Event, reason: Reason, now_ns: int, severity: Severity = Severity.WARNING) -> list[Notice]:
        """The notice that an event was not used, unless that was said just now."""
        key = ("" if reason is Reason.AT_A_POLE else type(event).__name__, reason)  # origin and position say the same
        last = self._last_ns.get(key)
        if last is not None and 0 <= now_ns - last < REPEAT_NS:
            return []
        self._last_ns[key] = now_ns
        data = (("reason", reason.value),)
        if reason is Reason.IMPLAUSIBLE_CLAIM and isinstance(event, Fix):
            return [Notice(severity, _of_claim(event), to_operator=True, data=data)]
        if reason is Reason.AT_A_POLE:
            return [Notice(severity, NO_POLES, to_operator=True, data=data)]
        return [Notice(severity, f"{key[0]} not used: {reason.value}", data=data)]


def _of_claim(fix: Fix) -> str:
    """A localiser that claims to be certain, or to know nothing, is not believed, and the operator flies without it."""
    sigmas_m = (math.sqrt(max(0.0, fix.cov_ne_m2[0][0])), math.sqrt(max(0.0, fix.cov_ne_m2[1][1])), fix.sigma_h_m)
    claimed_m = f"{max(sigmas_m):.0e}" if max(sigmas_m) > MAX_SIGMA_M else f"{min(sigmas_m):.2f}"
    return f"visloc: {fix.method[:12]} claims {claimed_m} m, FIXES REFUSED"
