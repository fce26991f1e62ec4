"""How often attitudes come: told once where it is too seldom to place frames, and held against them where it is useless.

A stream whose attitudes are each out of date before the next one comes would change the mode with each of them.
"""

from __future__ import annotations

from visloc_companion.types import Command, Notice, Severity

_NS_PER_S = 1_000_000_000
AGE_NS = 2 * _NS_PER_S
"""An attitude counts for so long."""
SLOW_AGE_NS, SLOW_NS = 2_500_000_000, 1_250_000_000
"""And so long where the last two came later than the second of these: one in 2 s is not out of date for a tick now and then."""
RARE_NS, RARE_N = 550_000_000, 10
"""So many in a row further apart than an attitude is interpolated (attitude.MAX_GAP_S): most frames have none."""
_USELESS_N, _AGAIN_N = 2, 3


class AttitudePace:
    """Of the attitudes that were taken; times of arrival."""

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._rare: list[int] = []
        self._n_slow = self._n_out_of_date = self._n_in_time = 0
        self._useless = self._told = False

    def fresh(self, now_ns: int) -> bool:
        """Whether an attitude came lately, of a stream that does not leave them out of date time and again."""
        age_ns = SLOW_AGE_NS if self._n_slow >= _USELESS_N else AGE_NS
        return self._last_ns is not None and now_ns - self._last_ns <= age_ns and not self._useless

    def came(self, t_rx_ns: int) -> list[Command]:
        """One was taken; what the operator is to be told."""
        before_ns, self._last_ns = self._last_ns, t_rx_ns
        if before_ns is None:
            return []
        gap_ns = t_rx_ns - before_ns
        self._n_slow = self._n_slow + 1 if gap_ns > SLOW_NS else 0
        self._n_out_of_date = self._n_out_of_date + 1 if gap_ns > SLOW_AGE_NS else 0
        self._n_in_time = self._n_in_time + 1 if gap_ns <= AGE_NS else 0
        if self._useless:
            self._useless = self._n_in_time < _AGAIN_N
        else:
            self._useless = self._n_out_of_date >= _USELESS_N
        if self._told:
            return []
        self._rare = [*self._rare, gap_ns] if gap_ns > RARE_NS else []
        return self._tell() if self._useless or len(self._rare) >= RARE_N else []

    def _tell(self) -> list[Command]:
        self._told = True
        rate_hz = len(self._rare) * _NS_PER_S / sum(self._rare)
        text = f"visloc: attitude comes at {rate_hz:.1f} Hz, too slow"
        return [Notice(Severity.WARNING, text, to_operator=True, data=(("rate_hz", rate_hz),))]
