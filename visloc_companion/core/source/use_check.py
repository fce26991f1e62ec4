"""Whether an autopilot uses the position source that it says it was switched to: its acknowledgement does not tell.

ArduPilot accepts a source that has no data and carries on with what it had. Its test ratio of the position is
that of the last position fused: while positions are fused it is another one with every report, and else stands still. PX4 tells
whether GNSS is in use, and whether anything horizontal aids it (ESTIMATOR_STATUS, 0x200 and 0x100); once EKF2_GPS_CTRL is 0 the
latter is not GNSS.
"""

from __future__ import annotations

from visloc_companion.types import EkfSource, EstimatorStatus

SETTLE_NS, JUDGE_NS, GIVE_UP_NS = 500_000_000, 3_000_000_000, 10_000_000_000
"""Reports of the first half second are of what was before. Judged is soon: without a position ArduPilot's failsafe comes after
7 s, PX4's after 4."""
ENOUGH = 4
"""Reports on which a verdict may rest."""


class UseCheck:
    """One check at a time; `judged` answers once."""

    def __init__(self) -> None:
        self.source: EkfSource | None = None
        self._begun_ns = 0
        self._reports = self._used = 0
        self._last_ratio: float | None = None

    def begin(self, source: EkfSource, now_ns: int) -> None:
        """The autopilot said that it flies on a source from now on."""
        self.source, self._begun_ns = source, now_ns
        self._reports = self._used = 0
        self._last_ratio = None

    def stop(self) -> None:
        """Nothing is to be judged any more."""
        self.source = None

    def hear(self, status: EstimatorStatus, now_ns: int) -> None:
        """Take a report of the estimator."""
        if self.source is None or now_ns - self._begun_ns < SETTLE_NS or status.position_ratio is None:
            return
        ratio, last = status.position_ratio, self._last_ratio
        self._last_ratio = ratio
        told = status.gnss_in_use if self.source is EkfSource.GNSS else status.aided
        if told is not None:
            fused = told
        elif last is None or ratio == last == 0.0:
            return
        else:
            fused = ratio != last
        self._reports += 1
        self._used += fused and ratio < 1.0 and status.horizontal_position_ok

    def judged(self, now_ns: int) -> bool | None:
        """True: the source is used; False: it is not; None: not known (yet, or ever)."""
        if self.source is None or now_ns - self._begun_ns < JUDGE_NS:
            return None
        if self._reports < ENOUGH and now_ns - self._begun_ns < GIVE_UP_NS:
            return None
        self.stop()
        return self._used > 0 if self._reports >= ENOUGH else None
