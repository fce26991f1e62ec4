"""TIMESYNC (111), both ways. Times are nanoseconds of each side's own clock.

A request has tc1 = 0 and ts1 = the asker's time; the reply has tc1 = the answerer's time and ts1 echoed.
"""

from __future__ import annotations

from collections import deque

from visloc_companion.adapters.mavlink.codec_gnss import BOOT_PERIOD_NS
from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.types import TimesyncSample

_MAX_OPEN = 32


class Timesync:
    """Answers the autopilot's requests and turns its replies to ours into samples; replies to others are ignored."""

    def __init__(self) -> None:
        self._open: deque[int] = deque(maxlen=_MAX_OPEN)

    def ask(self, now_ns: int) -> Message:
        """A request that names this instant."""
        t_sent_ns = max(1, now_ns)
        self._open.append(t_sent_ns)
        return mav.MAVLink_timesync_message(0, t_sent_ns)

    def take(self, msg: Message, now_ns: int) -> tuple[Message | None, TimesyncSample | None]:
        """The reply to send at once to a request, or the sample that a reply to us makes."""
        if msg.tc1 == 0:
            return mav.MAVLink_timesync_message(max(1, now_ns), msg.ts1), None
        if msg.ts1 not in self._open or msg.tc1 < 0:
            return None, None
        self._open.remove(msg.ts1)
        return None, TimesyncSample(now_ns, msg.ts1, msg.tc1 % BOOT_PERIOD_NS)

    def clear(self) -> None:
        """Forget the open requests (the autopilot may have been restarted)."""
        self._open.clear()
