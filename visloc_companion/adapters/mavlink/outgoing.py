"""The positions that a session sends, and those that it refuses to send."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from visloc_companion.adapters.mavlink.encode import vision_position_estimate
from visloc_companion.adapters.mavlink.outbox import Outbox
from visloc_companion.errors import Reason
from visloc_companion.types import GeoPoint, Injection, LinkChanged

_ACTIVE_FOR_NS = 2_000_000_000
_REFUSAL_TEXTS = {
    Reason.NO_ORIGIN: "no injection: the autopilot's EKF origin is not known",
    Reason.NOT_FINITE: "no injection: it holds a number that is not finite",
    Reason.BAD_INPUT: "no injection: it lies outside what the message can carry",
    Reason.IMPLAUSIBLE_TIME: "no injection: its time goes backwards",
}


class PositionSender:
    """Encodes injections for the autopilot at hand; `refused` counts by reason what was not sent, each told of once."""

    def __init__(self, outbox: Outbox, warn: Callable[[str], None]) -> None:
        self.refused: Counter[Reason] = Counter()
        self._outbox = outbox
        self._warn = warn
        self._last_ns = -_ACTIVE_FOR_NS

    def active(self, now_ns: int) -> bool:
        """Whether positions flow."""
        return now_ns - self._last_ns < _ACTIVE_FOR_NS

    def send(self, injection: Injection, link: LinkChanged, origin: GeoPoint | None) -> bool:
        """Queue the message; False, with a count and one warning a reason, where it must not be sent."""
        if not link.up:
            return False
        message = vision_position_estimate(injection, link.autopilot)
        refusal = message if isinstance(message, Reason) else self._refusal(injection, origin)
        if refusal is not None:
            if not self.refused[refusal]:
                self._warn(_REFUSAL_TEXTS[refusal])
            self.refused[refusal] += 1
            return False
        self._last_ns = injection.t_ns
        self._outbox.put(message)
        return True

    def _refusal(self, injection: Injection, origin: GeoPoint | None) -> Reason | None:
        if origin is None:
            return Reason.NO_ORIGIN
        return Reason.IMPLAUSIBLE_TIME if injection.t_ns < self._last_ns else None
