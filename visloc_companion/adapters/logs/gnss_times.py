"""Calendar time as a receiver states it in an autopilot's own log, beside the autopilot's clock."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

from visloc_companion.adapters.logs.recording import NS_PER_S
from visloc_companion.core.satellites.gnss_clock import JUMP_BY_ARRIVAL_NS
from visloc_companion.types import Event, GnssTime

Told = tuple[int, int]
"""Boot time of a receiver's message, and how much its UTC (Unix) is ahead of that, ns."""
_EVERY_NS = NS_PER_S


def unix_minus_boot_ns(told: Sequence[Told]) -> int | None:
    """UTC of the boot, the median of what the receiver says: one damaged week, or one before it was known, moves nothing."""
    return round(statistics.median(ahead_ns for _, ahead_ns in told)) if told else None


def gnss_times(told: Sequence[Told]) -> list[tuple[int, Event]]:
    """What SYSTEM_TIME would have told of it, at most once a second, of messages in time order.

    A message is written when it arrives, up to 0.8 s late in a log of 2014: `t_boot_ns` is 0, so that it counts by arrival. What
    neither the one before nor the one after bears out never was (the formats have no checksums).
    """
    made: list[tuple[int, Event]] = []
    for number, (t_ns, ahead_ns) in enumerate(told):
        beside = [told[at][1] for at in (number - 1, number + 1) if 0 <= at < len(told)]
        alone = bool(beside) and all(abs(ahead_ns - other_ns) > JUMP_BY_ARRIVAL_NS for other_ns in beside)
        if not alone and (not made or t_ns - made[-1][0] >= _EVERY_NS):
            made.append((t_ns, GnssTime(t_ns, 0, t_ns + ahead_ns)))
    return made
