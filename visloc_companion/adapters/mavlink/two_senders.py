"""Two autopilots with one system id on a link (a second vehicle on the telemetry, a log that is played into it).

One that is restarted has its clock go back once. Of two that were started at different times each message of the younger one
does: taken for restarts they would end the link many times a second, and what is heard is of two vehicles in turn.
"""

from __future__ import annotations

from collections import deque

_NS_PER_S = 1_000_000_000
ENOUGH, WITHIN_NS = 4, 10 * _NS_PER_S
"""So many steps back within so long are no restarts: after each an autopilot has to run for 5 s before the next is seen."""
QUIET_NS = 10 * _NS_PER_S
"""So long after the last step back one of them is taken to be gone."""
REMEDY = (
    "give each vehicle a number of its own (ArduPilot: MAV_SYSID, formerly SYSID_THISMAV; PX4: MAV_SYS_ID), or keep the other "
    "one off this link"
)


class TwoSenders:
    """Sans-IO."""

    def __init__(self) -> None:
        self._back_ns: deque[int] = deque(maxlen=ENOUGH)
        self._until_ns = 0

    def went_back(self, now_ns: int) -> bool:
        """The clock of the one that is listened to went back; True where that shows a second one of its number, which was not
        known."""
        known = self.there(now_ns)
        self._back_ns.append(now_ns)
        often = len(self._back_ns) == ENOUGH and now_ns - self._back_ns[0] <= WITHIN_NS
        if known or often:
            self._until_ns = now_ns + QUIET_NS
        return often and not known

    def there(self, now_ns: int) -> bool:
        """Whether there are two."""
        return now_ns < self._until_ns
