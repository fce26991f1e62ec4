"""Clock sanity: calendar time that came from GNSS must run as the autopilot's own clock does.

SYSTEM_TIME carries both in one message, so a jump of their difference is a jump of GNSS time (or of whoever sets the clock). The
first difference is the reference; it is followed while it is good, so that a crystal's drift does not add up. PX4 sets its clock
from the receiver again and again; ArduPilot takes GNSS time once and, while armed, never moves it (AP_RTC::set_utc_usec), so
there a jump shows on the ground only.
"""

from __future__ import annotations

from visloc_companion.types import GnssTime

JUMP_NS = 100_000_000
JUMP_BY_ARRIVAL_NS = 1_500_000_000
"""Where a time has no boot time beside it, its arrival stands in, which jitters."""
DRIFT = 100e-6
"""Crystals are good to 100 parts in a million."""
GAP_NS = 2_500_000_000
"""After a longer silence (a link that was lost, an autopilot that restarted) there is nothing to compare."""
SIGN_NS = 10_000_000_000
"""A jump speaks against GNSS for so long, then the new time is the reference (a receiver that learns the leap seconds)."""


class GnssClock:
    """Follows the difference between GNSS time and boot time."""

    def __init__(self) -> None:
        self._reference: tuple[int, int, bool] | None = None
        self._jumped_ns: int | None = None
        self._heard_ns: int | None = None
        self.jump_s = 0.0

    def on_time(self, event: GnssTime) -> None:
        """Take a calendar time."""
        by_boot = event.t_boot_ns > 0
        t_ns = event.t_boot_ns if by_boot else event.t_rx_ns
        offset = event.t_unix_ns - t_ns
        silent = self._heard_ns is not None and event.t_rx_ns - self._heard_ns > GAP_NS
        self._heard_ns = event.t_rx_ns
        if self._reference is None or self._reference[2] != by_boot or t_ns < self._reference[0] or silent:
            self._reference = (t_ns, offset, by_boot)  # another clock, or a restart of it: nothing to compare
            return
        jump = offset - self._reference[1]
        allowed = (JUMP_NS if by_boot else JUMP_BY_ARRIVAL_NS) + DRIFT * (t_ns - self._reference[0])
        if abs(jump) > allowed:
            self.jump_s, self._jumped_ns = jump * 1e-9, event.t_rx_ns
        self._reference = (t_ns, offset, by_boot)

    def signs(self, now_ns: int) -> tuple[str, ...]:
        """`clock_jump` for SIGN_NS after a jump."""
        recent = self._jumped_ns is not None and 0 <= now_ns - self._jumped_ns <= SIGN_NS
        return ("clock_jump",) if recent else ()
