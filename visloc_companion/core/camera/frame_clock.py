"""When frames were taken that bear the time of their arrival only: a camera's clock runs evenly, the way to us does not.

Arrivals are phase and period of an even clock, and jitter: a Kalman filter of two states takes the jitter's size from its own
innovations (as Mills 1991 does for network time). What all frames are late by together stays in; core/camera/time_offset.py finds
that. A stream that is not even (dropped frames, another rate) moves the mean of the innovations: then the phase begins anew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

RESTART_GAP_S = 2.0
SETTLED_FRAMES = 20
"""Phase and period are fitted to so many arrivals first (least squares)."""
LEAST_JITTER_S = 0.0005
DRIFT = 2e-6
WANDER_S_PER_SQRT_S = 2e-4
"""Random walks of the camera's clock: its rate (s/s for each root second), and its time."""
CLIP_SIGMA = 3.0
JITTER_FRAMES, MEAN_FRAMES = 100, 12
SLIP_SIGMA = 5.0
"""The mean of so many innovations beyond so many of its sigmas is that of another phase."""
SKIP_SIGMA, SKIP_SHARE = 5.0, 0.25
"""An innovation of so many sigmas, that share of a period around a whole number of them, is that of frames that never came."""

OVERTAKEN = 10
"""A frame that comes after one of so many later ones was overtaken; more, and the camera counts anew."""


@dataclass(frozen=True, slots=True)
class Taken:
    """When a frame was taken, less what all are late by, and the 1-sigma of the part that is its own (seconds)."""

    t_ns: int
    sigma_s: float


class FrameClock:
    """The even clock behind arrivals. `jumps`: how often its phase began anew."""

    def __init__(self) -> None:
        self.jumps = -1
        self._restart()

    @property
    def period_s(self) -> float:
        """Of the frames, 0 until it is known."""
        return self._period_s

    def _restart(self) -> None:
        self.jumps += 1
        self._first: list[tuple[int, int]] = []
        self._last = (0, 0)
        self._late_s, self._period_s = 0.0, 0.0
        self._P = (0.0, 0.0, 0.0)
        self._var, self._mean, self._n = 0.0, 0.0, 0

    def on_arrival(self, t_ns: int, frame_id: int) -> Taken:
        """Take an arrival; frames are numbered in the order in which they come. Until the clock is known, the arrival stands."""
        last = self._last
        dt_s, steps = (t_ns - last[0]) * 1e-9, frame_id - last[1]
        settled = len(self._first) == SETTLED_FRAMES
        if settled and -OVERTAKEN < steps < 1 and 0 <= dt_s <= RESTART_GAP_S:
            return Taken(last[0] + round((steps * self._period_s - self._late_s) * 1e9), math.sqrt(self._P[0]))
        if self._first and (steps < 1 or not 0 < dt_s <= RESTART_GAP_S):
            self._restart()
        self._last = (t_ns, frame_id)
        if len(self._first) < SETTLED_FRAMES:
            self._first.append((t_ns, frame_id))
            if len(self._first) == SETTLED_FRAMES:
                self._begin()
            return Taken(t_ns, self._jitter_s())
        if not self._updated(dt_s, steps):
            self._restart()
            self._last, self._first = (t_ns, frame_id), [(t_ns, frame_id)]
            return Taken(t_ns, 0.0)
        return Taken(t_ns - round(self._late_s * 1e9), math.sqrt(self._P[0]))

    def _jitter_s(self) -> float:
        """1-sigma of the arrivals at the beginning, about their own line."""
        if len(self._first) < 3:
            return 0.0
        return math.sqrt(self._line()[2])

    def _line(self) -> tuple[float, float, float, float]:
        """Lateness of the last arrival behind the line of least squares, its slope, the variance about it, the squares' sum."""
        t0_ns, id0 = self._first[0]
        n = len(self._first)
        x = [float(i - id0) for _, i in self._first]
        y = [(t - t0_ns) * 1e-9 for t, _ in self._first]
        mx, my = sum(x) / n, sum(y) / n
        xx = sum((a - mx) ** 2 for a in x)
        slope = sum((a - mx) * (b - my) for a, b in zip(x, y, strict=True)) / xx
        left = [b - my - slope * (a - mx) for a, b in zip(x, y, strict=True)]
        return left[-1], slope, sum(r * r for r in left) / (n - 2), xx

    def _begin(self) -> None:
        self._late_s, self._period_s, var, xx = self._line()
        self._var = max(var, LEAST_JITTER_S**2)
        n, ids = len(self._first), [i for _, i in self._first]
        end = ids[-1] - sum(ids) / n
        self._P = (self._var * (1 / n + end * end / xx), self._var * end / xx, self._var / xx)

    def _updated(self, dt_s: float, steps: int) -> bool:
        """Take an arrival; False where phase or rate are others than before."""
        period_s, (pp, pt, tt) = self._period_s, self._P
        ahead = self._late_s + dt_s - steps * period_s
        missed = round(ahead / period_s)
        if missed >= 1 and ahead > SKIP_SIGMA * math.sqrt(self._var) and abs(ahead / period_s - missed) < SKIP_SHARE:
            steps += missed
            ahead -= missed * period_s
        pp += 2 * steps * pt + steps * steps * tt + WANDER_S_PER_SQRT_S**2 * dt_s
        pt += steps * tt
        tt += (DRIFT * period_s) ** 2 * dt_s
        s = pp + self._var
        clip = CLIP_SIGMA * math.sqrt(s)
        e = max(-clip, min(clip, ahead))
        gain, gain_t = pp / s, pt / s
        self._late_s, self._period_s = ahead - gain * e, period_s + gain_t * e
        self._P = (pp * (1 - gain), pt * (1 - gain), tt - gain_t * pt)
        self._var = max(LEAST_JITTER_S**2, self._var + (e * e * (1 - gain) - self._var) / JITTER_FRAMES)
        self._n += 1
        self._mean += (ahead - self._mean) / min(self._n, MEAN_FRAMES)
        alone = self._n < MEAN_FRAMES or abs(self._mean) < SLIP_SIGMA * math.sqrt(s / (2 * MEAN_FRAMES))
        return alone and self._period_s > 0
