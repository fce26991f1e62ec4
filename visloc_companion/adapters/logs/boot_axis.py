"""One monotonic time base out of an autopilot's boot clock and a ground station's clock, either of which may jump."""

from __future__ import annotations

from dataclasses import dataclass

from visloc_companion.adapters.logs.recording import NS_PER_MS, NS_PER_S, NS_PER_US, Losses

_BACK_NS = 1 * NS_PER_S
_FORWARD_NS = 3600 * NS_PER_S
_MAX_LAG_NS = 10 * NS_PER_S
_WRAP_NS = 2**32 * NS_PER_MS
"""time_boot_ms has 32 bits: after 49.7 days it begins anew, without a restart."""
_SILENCE_NS = 5 * NS_PER_S
"""Only when no stamped message came for so long, the ground station's clock moves time on."""


@dataclass(frozen=True, slots=True)
class Instant:
    """When a record was sent (`t_ns`), what to add to its boot time (`boot_shift_ns`), and whether the autopilot restarted."""

    t_ns: int
    boot_shift_ns: int
    rebooted: bool


class BootAxis:
    """Places records on the autopilot's boot clock of the log's first part.

    A record whose message has a boot time lies there: a ground station writes in bursts, which would look like silence of the
    autopilot. A record without one lies at the last stamped record, after a long silence as far on as the ground station's clock
    says, but never behind the next stamped record of that boot. Time never goes back: small disorder is flattened, a step
    of the wall clock has no effect but in long stretches without stamps, and after a reboot or where its 32 bits overflow the
    boot clock is continued (its shift grows): times before and after stay apart. Steps and reboots are counted in `losses`.
    `unix_minus_boot_ns` places records before the first stamped one.
    """

    def __init__(self, unix_minus_boot_ns: int, losses: Losses) -> None:
        self._zero_ns = unix_minus_boot_ns
        self._losses = losses
        self._t_ns: int | None = None
        self._wall_ns = 0
        self._stamped: tuple[int, int] | None = None
        self._boot: tuple[int, int] | None = None
        self._n_steps = 0
        self._shift_ns = 0
        self._wrapped_ns = 0

    def place(self, wall_us: int, boot_ms: int | None, next_boot_ms: int | None = None) -> Instant:
        """The instant of a record, from the ground station's stamp and, where its message has one, its boot time.

        `next_boot_ms`: the boot time of the next record whose message has one.
        """
        wall_ns = wall_us * NS_PER_US
        boot_ns = None if boot_ms is None else self._unwrapped(boot_ms * NS_PER_MS)
        restarted = boot_ns is not None and self._restarted(boot_ns, wall_ns)
        if self._t_ns is not None and not -_BACK_NS <= wall_ns - self._wall_ns <= _FORWARD_NS:
            self._losses.clock_steps += 1
            self._zero_ns += wall_ns - self._wall_ns
            if self._stamped is not None:
                self._stamped = (self._stamped[0], self._stamped[1] + wall_ns - self._wall_ns)
        self._wall_ns = wall_ns
        if boot_ns is None:
            t_ns = self._between(wall_ns, next_boot_ms)
        else:
            if restarted and self._stamped is not None:
                self._losses.reboots += 1
                self._shift_ns = self._stamped[0] + max(0, wall_ns - self._stamped[1]) - boot_ns
            elif self._silent(boot_ns, wall_ns):
                self._losses.clock_steps = self._n_steps
            self._boot, self._n_steps = (boot_ns, wall_ns), self._losses.clock_steps
            t_ns = boot_ns + self._shift_ns
            self._stamped = (t_ns, wall_ns)
        self._t_ns = t_ns if self._t_ns is None else max(t_ns, self._t_ns)
        return Instant(self._t_ns, self._shift_ns + self._wrapped_ns, restarted)

    def _unwrapped(self, boot_ns: int) -> int:
        if self._boot is not None:
            ahead_ns = (boot_ns + self._wrapped_ns - self._boot[0] + _BACK_NS) % _WRAP_NS - _BACK_NS
            if ahead_ns <= _FORWARD_NS:
                self._wrapped_ns = self._boot[0] + ahead_ns - boot_ns
        return boot_ns + self._wrapped_ns

    def _restarted(self, boot_ns: int, wall_ns: int) -> bool:
        """A boot time that goes back by a few seconds tells of a restart only where there was time for one: links that lag by
        seconds bring some of what was sent twice."""
        if self._boot is None or -_BACK_NS <= (ahead_ns := boot_ns - self._boot[0]) <= _FORWARD_NS:
            return False
        if ahead_ns > 0:
            return not self._silent(boot_ns, wall_ns)
        return ahead_ns < -_MAX_LAG_NS or boot_ns - self._wrapped_ns <= wall_ns - self._boot[1] + _BACK_NS

    def _silent(self, boot_ns: int, wall_ns: int) -> bool:
        """Whether both clocks went on by the same hours: nothing was recorded meanwhile, and none of them stepped."""
        if self._boot is None or boot_ns - self._boot[0] <= _FORWARD_NS:
            return False
        return abs((boot_ns - self._boot[0]) - (wall_ns - self._boot[1])) <= _MAX_LAG_NS

    def _between(self, wall_ns: int, next_boot_ms: int | None) -> int:
        if self._stamped is None or self._boot is None:
            t_ns = wall_ns - self._zero_ns
            return t_ns if next_boot_ms is None else max(0, min(t_ns, next_boot_ms * NS_PER_MS))
        t_ns, then_ns = self._stamped
        silent_ns = max(0, wall_ns - then_ns - _SILENCE_NS)
        if next_boot_ms is not None:
            boot_ns = next_boot_ms * NS_PER_MS + self._wrapped_ns
            ahead_ns = (boot_ns - self._boot[0] + _BACK_NS) % _WRAP_NS - _BACK_NS
            if ahead_ns <= _FORWARD_NS:  # else it is of another boot
                silent_ns = min(silent_ns, max(0, ahead_ns))
        return t_ns + silent_ns


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
