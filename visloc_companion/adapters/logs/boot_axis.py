"""One monotonic time base out of a ground station's clock and an autopilot's boot clock, either of which may jump."""

from __future__ import annotations

from dataclasses import dataclass

from visloc_companion.adapters.logs.recording import NS_PER_MS, NS_PER_S, NS_PER_US, Losses

_BACK_NS = 1 * NS_PER_S
_FORWARD_NS = 3600 * NS_PER_S
_MAX_LAG_NS = 10 * NS_PER_S
"""More delay than this between the autopilot's stamp and the ground station's is a step of the latter's clock."""


@dataclass(frozen=True, slots=True)
class Instant:
    """When a record arrived (`t_ns`), what to add to its boot time (`boot_shift_ns`), and whether the autopilot restarted."""

    t_ns: int
    boot_shift_ns: int
    rebooted: bool


class BootAxis:
    """Places records with wall-clock stamps on the autopilot's boot clock of the log's first part.

    `unix_minus_boot_ns` is the smallest difference that was seen, so that a record is never earlier than it was sent.
    Time never goes back: small disorder is flattened, a step of the wall clock is taken out, and after a reboot the boot
    clock is continued (its shift grows), so that times before and after stay apart. Steps and reboots are counted.
    """

    def __init__(self, unix_minus_boot_ns: int, losses: Losses) -> None:
        self._zero_ns = unix_minus_boot_ns
        self._losses = losses
        self._last_ns: int | None = None
        self._last_boot_ns: int | None = None
        self._shift_ns = 0

    def place(self, wall_us: int, boot_ms: int | None) -> Instant:
        """The instant of a record, from its stamp and, where its message has one, its boot time."""
        t_ns = wall_us * NS_PER_US - self._zero_ns
        if self._last_ns is not None and not -_BACK_NS <= t_ns - self._last_ns <= _FORWARD_NS:
            self._step(t_ns - self._last_ns)
            t_ns = self._last_ns
        rebooted = False
        if boot_ms is not None:
            boot_ns = boot_ms * NS_PER_MS
            rebooted = self._last_boot_ns is not None and not -_BACK_NS <= boot_ns - self._last_boot_ns <= _FORWARD_NS
            if rebooted:
                self._losses.reboots += 1
                self._shift_ns = t_ns - boot_ns
            lag_ns = t_ns - (boot_ns + self._shift_ns)
            if not -_BACK_NS <= lag_ns <= _MAX_LAG_NS:
                self._step(lag_ns)
                t_ns -= lag_ns
            self._last_boot_ns = boot_ns
        self._last_ns = t_ns if self._last_ns is None else max(t_ns, self._last_ns)
        return Instant(self._last_ns, self._shift_ns, rebooted)

    def _step(self, by_ns: int) -> None:
        self._losses.clock_steps += 1
        self._zero_ns += by_ns


def smallest_difference_ns(stamps: list[tuple[int, int]]) -> int:
    """Unix minus boot time (ns) of the log's first part, from (wall_us, boot_ms): the least delayed record before a reboot.

    A zero-length list gives 0.
    """
    smallest: int | None = None
    last_boot = None
    for wall_us, boot_ms in stamps:
        difference = wall_us * NS_PER_US - boot_ms * NS_PER_MS
        if last_boot is not None and boot_ms < last_boot - 1000:
            break
        if smallest is None or smallest - _MAX_LAG_NS < difference < smallest:
            smallest = difference
        last_boot = boot_ms
    return smallest or 0
