"""Two autopilots with one system id on a link (a second vehicle on the telemetry, a log that is played into it).

One that is restarted has its clock go back once. Of two that were started at different times each message of the younger one
does: taken for restarts they would end the link many times a second, and what is heard is of two vehicles in turn. Two that were
started within seconds look like one whose messages overtake each other, for minutes on end and by more than any network has it.
"""

from __future__ import annotations

from collections import deque

from visloc_companion.types import Attitude, Event

_NS_PER_S = 1_000_000_000
ENOUGH, WITHIN_NS = 4, 10 * _NS_PER_S
"""So many steps back within so long are no restarts: after each an autopilot has to run for 5 s before the next is seen."""
QUIET_NS = 10 * _NS_PER_S
"""So long after the last step back one of them is taken to be gone."""
RESTART_NS = 5 * _NS_PER_S
"""A clock that goes back by more was restarted (presence.py)."""
OVERTAKEN_NS, STRAYS, EVERY_NS = _NS_PER_S // 5, 20, _NS_PER_S // 4
"""Attitudes that are behind others by more than networks let them overtake each other, in so many quarters of a second within
WITHIN_NS, are of a second autopilot, unless half as often some came twice: one that is heard by two ways, of which the slower
brings what the other has lost."""
REMEDY = (
    "give each vehicle a number of its own (ArduPilot: MAV_SYSID, formerly SYSID_THISMAV; PX4: MAV_SYS_ID), or keep the other "
    "one off this link"
)


class TwoSenders:
    """Sans-IO."""

    def __init__(self) -> None:
        self._back_ns: deque[int] = deque(maxlen=ENOUGH)
        self._until_ns = 0
        self._newest_ns = 0
        self._heard_ns: deque[int] = deque(maxlen=512)
        self._strays_ns: deque[int] = deque(maxlen=STRAYS)
        self._twice_ns: deque[int] = deque(maxlen=STRAYS)

    def went_back(self, now_ns: int) -> bool:
        """The clock of the one that is listened to went back; True where that shows a second one of its number, which was not
        known."""
        known = self.there(now_ns)
        self._back_ns.append(now_ns)
        often = len(self._back_ns) == ENOUGH and now_ns - self._back_ns[0] <= WITHIN_NS
        if known or often:
            self._until_ns = now_ns + QUIET_NS
        return often and not known

    def in_turn(self, event: Event, now_ns: int) -> bool:
        """Hear an event; True where attitudes show a second autopilot that was started within seconds, which was not known."""
        if not isinstance(event, Attitude):
            return False
        t_ns, newest_ns = event.t_boot_ns, self._newest_ns
        if t_ns in self._heard_ns:
            _note(self._twice_ns, now_ns)
            return False
        self._heard_ns.append(t_ns)
        self._newest_ns = t_ns if t_ns < newest_ns - RESTART_NS else max(t_ns, newest_ns)
        if t_ns >= self._newest_ns - OVERTAKEN_NS:
            return False
        _note(self._strays_ns, now_ns)
        n_twice = sum(now_ns - then_ns <= WITHIN_NS for then_ns in self._twice_ns)
        often = len(self._strays_ns) == STRAYS and now_ns - self._strays_ns[0] <= WITHIN_NS and 2 * n_twice < STRAYS
        known = self.there(now_ns)
        if known or often:
            self._until_ns = now_ns + QUIET_NS
        return often and not known

    def there(self, now_ns: int) -> bool:
        """Whether there are two."""
        return now_ns < self._until_ns


def _note(times_ns: deque[int], now_ns: int) -> None:
    if not times_ns or now_ns - times_ns[-1] >= EVERY_NS:
        times_ns.append(now_ns)
