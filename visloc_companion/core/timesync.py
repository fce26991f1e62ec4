"""The offset of the shell's clock from the autopilot's: `t_ns = t_boot_ns + offset`.

Two sources. Every time-stamped message gives `arrival - boot time`, which is the offset plus a latency of at least zero, so
the smallest of a window is an upper bound that is late by the shortest latency only. A TIMESYNC exchange gives the offset to
within half of its round trip; the exchange with the shortest round trip of the window is taken. Windows are two buckets, so
that a drifting clock is followed. Messages and their time bases: docs of `types.Attitude`, MAVLink TIMESYNC (111).
"""

from __future__ import annotations

from dataclasses import dataclass

from visloc_companion.types import TimesyncSample

BUCKET_NS = 10_000_000_000
BACK_NS = 5_000_000_000
"""A boot time that falls back by so much is a clock step: no link is so late, or sends again what is so old."""
EARLY_NS = 5_000_000_000
"""A message may be so much earlier than the ones before, which then were late; beyond that the clock was set forward."""
STEP_NS, LATE_FOR_NS = 500_000_000, 5_000_000_000
"""Messages that are all later than the offset by STEP_NS for so long are a clock step, too."""
MAX_ROUND_TRIP_NS = 50_000_000


@dataclass(frozen=True, slots=True)
class ClockStep:
    """One of both clocks was set, or the autopilot restarted; `jump_ns` is by how much the offset changed.

    `of_autopilot`: its stamps fell back, which they do for no step of the shell's clock. Without that either may have stepped.
    """

    jump_ns: int
    of_autopilot: bool = False

    @property
    def of_restart(self) -> bool:
        """Whether the autopilot may have been restarted, or another one have come: less than that is a clock that was set, or a
        link that has become late."""
        return self.of_autopilot or abs(self.jump_ns) > BACK_NS


class _Smallest:
    """Entry with the smallest key over the last one to two buckets."""

    def __init__(self) -> None:
        self._start_ns = 0
        self._current: tuple[int, int] | None = None
        self._previous: tuple[int, int] | None = None
        self.value: int | None = None

    def add(self, t_ns: int, key: int, value: int) -> None:
        if self._current is None or t_ns - self._start_ns > BUCKET_NS:
            expired = t_ns - self._start_ns > 2 * BUCKET_NS
            self._previous = None if expired else self._current
            self._current, self._start_ns = (key, value), t_ns
        elif key <= self._current[0]:
            self._current = min(self._current, (key, value))
        smallest, previous = self._current, self._previous
        self.value = smallest[1] if previous is None or smallest <= previous else previous[1]


class ClockOffset:
    """Estimates the offset from arrivals and TIMESYNC exchanges, and says when one of both clocks stepped."""

    def __init__(self) -> None:
        self._reset()

    def _reset(self) -> None:
        self._one_way = _Smallest()
        self._exchanges = _Smallest()
        self._last_boot_ns: int | None = None
        self._late_since_ns: int | None = None

    def on_arrival(self, t_rx_ns: int, t_boot_ns: int) -> ClockStep | None:
        """Take the arrival of a message that carries boot time."""
        arrived = t_rx_ns - t_boot_ns
        offset = self.offset_ns()
        step = None if offset is None else self._step(t_rx_ns, t_boot_ns, arrived - offset)
        if step is not None:
            self._reset()
        self._last_boot_ns = t_boot_ns
        self._one_way.add(t_rx_ns, arrived, arrived)
        return step

    def _step(self, t_rx_ns: int, t_boot_ns: int, late_ns: int) -> ClockStep | None:
        fell_back = self._last_boot_ns is not None and t_boot_ns < self._last_boot_ns - BACK_NS
        if late_ns < STEP_NS:
            self._late_since_ns = None
        elif self._late_since_ns is None:
            self._late_since_ns = t_rx_ns
        late_for_long = self._late_since_ns is not None and t_rx_ns - self._late_since_ns > LATE_FOR_NS
        return ClockStep(late_ns, fell_back) if fell_back or late_ns < -EARLY_NS or late_for_long else None

    def on_exchange(self, sample: TimesyncSample) -> ClockStep | None:
        """Take a TIMESYNC exchange; those with an impossible or long round trip are not used."""
        round_trip_ns = sample.t_rx_ns - sample.t_sent_ns
        if not 0 <= round_trip_ns <= MAX_ROUND_TRIP_NS:
            return None
        measured = (sample.t_sent_ns + sample.t_rx_ns) // 2 - sample.t_remote_ns
        offset = self.offset_ns()
        step = None
        if offset is not None and not -EARLY_NS <= measured - offset <= STEP_NS:
            step = ClockStep(measured - offset)
            self._reset()
        self._exchanges.add(sample.t_rx_ns, round_trip_ns, measured)
        return step

    def offset_ns(self) -> int | None:
        """Shell clock minus boot clock, or None before anything arrived."""
        exchanged, arrived = self._exchanges.value, self._one_way.value
        if exchanged is None or arrived is None:
            return arrived if exchanged is None else exchanged
        return exchanged if exchanged < arrived else arrived

    def shell_ns(self, t_boot_ns: int, fallback_ns: int) -> int:
        """Shell time of a boot time; the fallback (arrival) where the offset is unknown."""
        offset = self.offset_ns()
        return fallback_ns if offset is None else t_boot_ns + offset

    def boot_ns(self, t_ns: int) -> int | None:
        """Boot time of a shell time."""
        offset = self.offset_ns()
        return None if offset is None else t_ns - offset
