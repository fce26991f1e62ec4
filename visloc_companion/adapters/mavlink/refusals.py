"""Positions that are not sent: counted by reason, told once a reason in the log, and to the operator where it lasts.

An autopilot that flies on vision and is sent nothing lets its failsafe act within seconds: who looks on must not read that
positions are sent.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from visloc_companion.errors import Reason
from visloc_companion.types import Notice, Severity

LASTS_NS = 1_000_000_000
"""A single late position, or an origin that is asked for once more, costs nothing."""
_FAULTY = "faulty, see the log"
REASONS = {
    Reason.NO_ORIGIN: ("the autopilot's EKF origin is not known", "EKF origin not known"),
    Reason.NOT_FINITE: ("it holds a number that is not finite", _FAULTY),
    Reason.BAD_INPUT: (
        "it lies outside what may be sent, or is about another origin than the autopilot's",
        "unfit for its origin",
    ),
    Reason.IMPLAUSIBLE_TIME: ("its time goes backwards, or lies ahead", _FAULTY),
    Reason.TOO_OLD: ("it is too old (is the computer overloaded?)", "late, computer overloaded?"),
    Reason.NOT_SEEDED: ("the velocity that its message needs is not known", "velocity not known"),
    Reason.OUTSIDE_MAP: ("it lies further outside the map than injection.max_outside_map_m allows", "too far outside the map"),
}
"""In the log, and in the 33 characters that `visloc NOT SENT: ` leaves of a STATUSTEXT."""


class Refusals:
    """`warn` is the log, `say` reaches the operator; `counts` by reason."""

    def __init__(self, warn: Callable[[str], None], say: Callable[[Notice], None]) -> None:
        self.counts: Counter[Reason] = Counter()
        self._warn, self._say = warn, say
        self._since_ns: int | None = None
        self._last_ns = 0
        self._told = ""

    @property
    def lasting(self) -> str:
        """Why nothing has been sent for a while, in a few words; empty while positions go out."""
        return self._told

    def refused(self, reason: Reason, now_ns: int) -> None:
        """A position was not sent."""
        log, words = REASONS[reason]
        if not self.counts[reason]:
            self._warn(f"no injection: {log}")
        self.counts[reason] += 1
        if self._since_ns is None or now_ns - self._last_ns >= LASTS_NS:  # none were to be sent meanwhile
            self._since_ns, self._told = now_ns, ""
        self._last_ns = now_ns
        if now_ns - self._since_ns >= LASTS_NS and words != self._told:
            self._told = words
            self._say(Notice(Severity.CRITICAL, f"visloc NOT SENT: {words}", to_operator=True))

    def sent(self) -> None:
        """A position was sent."""
        if self._told:
            self._say(Notice(Severity.NOTICE, "visloc: positions are sent again", to_operator=True))
        self._since_ns, self._told = None, ""
