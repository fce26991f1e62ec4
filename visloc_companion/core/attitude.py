"""Ring buffer of attitudes on the autopilot's clock: the attitude at mid-exposure of a frame."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import deque
from itertools import chain, islice

import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import Reason
from visloc_companion.geo import se3
from visloc_companion.types import FloatArray, Quat, Vec3

SPAN_NS = 6_000_000_000
MAX_EXTRAPOLATION_S = 0.1
MAX_GAP_S = 0.5


class AttitudeBuffer:
    """The attitudes of the last seconds, by the autopilot's boot time.

    Between two samples no further apart than `MAX_GAP_S` it interpolates (slerp); otherwise it turns the
    nearest sample with its body rates, at most `MAX_EXTRAPOLATION_S` either way.
    """

    def __init__(self) -> None:
        self._t_ns: deque[int] = deque()
        self._q: deque[Quat] = deque()
        self._rate: deque[Vec3] = deque()

    def add(self, t_boot_ns: int, q_ned_frd: Quat, rate_frd_radps: Vec3) -> Reason | None:
        """Take a sample; IMPLAUSIBLE_TIME for one that is not later than the last, NOT_FINITE for a broken one."""
        if not all(map(math.isfinite, rate_frd_radps)):
            return Reason.NOT_FINITE
        try:
            q = se3.normalised(q_ned_frd)  # which none is that is not finite
        except ValueError:
            return Reason.NOT_FINITE
        if self._t_ns and t_boot_ns <= self._t_ns[-1]:
            return Reason.IMPLAUSIBLE_TIME
        self._t_ns.append(t_boot_ns)
        self._q.append(q)
        self._rate.append(rate_frd_radps)
        while self._t_ns[0] < t_boot_ns - SPAN_NS:
            self._t_ns.popleft()
            self._q.popleft()
            self._rate.popleft()
        return None

    def at(self, t_boot_ns: int) -> Quat | None:
        """`q_ned_frd` at a time, or None where no sample is near enough."""
        after = bisect_right(self._t_ns, t_boot_ns)
        before = after - 1
        if before >= 0 and after < len(self._t_ns):
            gap_ns = self._t_ns[after] - self._t_ns[before]
            if gap_ns <= MAX_GAP_S * 1e9:
                return se3.slerp(self._q[before], self._q[after], (t_boot_ns - self._t_ns[before]) / gap_ns)
        if not self._t_ns:
            return None
        if before < 0 or after == len(self._t_ns):
            nearest = max(before, 0)
        else:
            nearest = before if t_boot_ns - self._t_ns[before] <= self._t_ns[after] - t_boot_ns else after
        dt_s = (t_boot_ns - self._t_ns[nearest]) * 1e-9
        if abs(dt_s) > MAX_EXTRAPOLATION_S:
            return None
        return turned(self._q[nearest], self._rate[nearest], dt_s)

    def rate_frd_radps(self, t_boot_ns: int, span_ns: int) -> Vec3 | None:
        """Mean body rates over a span about a time, or None where no sample is near enough."""
        before, after = self.at(t_boot_ns - span_ns // 2), self.at(t_boot_ns + span_ns // 2)
        return None if before is None or after is None else se3.body_rates(before, after, span_ns * 1e-9)

    def between(self, from_ns: int, to_ns: int) -> tuple[NDArray[np.int64], FloatArray]:
        """Times (N,) and attitudes (N, 4) of the samples of an interval; neighbours have the same sign."""
        first, end = bisect_left(self._t_ns, from_ns), bisect_right(self._t_ns, to_ns)
        t_ns = np.fromiter(islice(self._t_ns, first, end), np.int64, end - first)
        q = np.fromiter(chain.from_iterable(islice(self._q, first, end)), np.float64, 4 * (end - first)).reshape(-1, 4)
        if len(q) > 1:
            q[1:] *= np.cumprod(np.where((q[1:] * q[:-1]).sum(1) < 0, -1.0, 1.0))[:, None]
        return t_ns, q

    def newest_boot_ns(self) -> int | None:
        """Time of the newest sample."""
        return self._t_ns[-1] if self._t_ns else None

    def clear(self) -> None:
        """Forget everything (the autopilot's clock stepped)."""
        self._t_ns.clear()
        self._q.clear()
        self._rate.clear()


def turned(q_ned_frd: Quat, rate_frd_radps: Vec3, dt_s: float) -> Quat:
    """The attitude after turning with constant body rates."""
    x, y, z = rate_frd_radps
    return se3.quat_multiply(q_ned_frd, se3.quat_from_vector((x * dt_s, y * dt_s, z * dt_s)))
