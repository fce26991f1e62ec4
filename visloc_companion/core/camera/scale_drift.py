"""Finds pictures whose scale drifts away from that of the map: a camera that zooms slowly, or ground that no map shows.

A lens that becomes longer makes the ground seem nearer; so do woods and hills that the map has not. Both are in the heights of
fixes, and while these are held to what was known before, no place explains the picture. So from a drift of 2 % on heights are
let loose, and the lens is doubted by as much as they show. What tells both apart is the side to which the camera leans: a wrong
lens puts the place off by a share of what it looks ahead, ground that is higher leaves it where it is. Where it should be says a
GNSS that is trusted, or else the accelerations since before the drift; odometry looks through the same lens, and says what fixes
say.

A height of the autopilot that drifts (barometer) looks as ground does.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import fmean, median
from typing import NamedTuple

import numpy as np

from visloc_companion.core.filter.propagation import Drive
from visloc_companion.core.filter.reckoned import Reckoned
from visloc_companion.types import Cov2, FloatArray, Vec2

KEPT_NS, BEFORE_NS, RECENT_NS = 25_000_000_000, 12_000_000_000, 1_500_000_000
"""Fixes are remembered for so long; those of so long, up to so shortly ago, show the height before a drift."""
FEWEST, NEWEST, LAST_NS, LAST = 5, 2, 2_600_000_000, 3
"""So many fixes before, and so many within so short a time after, where a drift begins; the last ones that are held against
earlier ones."""
LEAST_SHARE, BEGUN_SHARE, LEAST_SPREADS, LEAST_CLAIMS = 0.02, 0.01, 4.0, 1.2
"""Of the height flown: what the newest fix and all of the last ones must be off by; and so many times the median of what those
before are off by, and what both claim (1-sigma)."""
TOLD, SILENT, LOOSE_NS = 6, 2, 2_000_000_000
"""So many fixes in a row told the height, the last of them another one (BEGUN_SHARE), and then so many did not, or were refused:
heights may be held too tightly for any to explain the picture, and are let loose for so long. Where they had stayed it is the
ground that tells little: a wood would have its crowns taken for a height then."""
BACK_NS, STEADY = 4_000_000_000, 10
"""The drift is over where the height is back for so long, or has stayed through so many fixes where it went."""
BANDS_NS = ((3_000_000_000, 8_000_000_000), (8_000_000_000, 14_000_000_000), (14_000_000_000, KEPT_NS))
"""How long ago the fixes were that those of now are compared with."""
SURE, WORTH, MOST_LEFT = 5.0, 2.0, 5.0
"""Natural logarithm of the odds that decide; pairs of fixes tell by so much more than the mean one; and the mean of what the
lens may leave, squared in sigmas (2 is ordinary)."""
OTHER_M2 = 1.0
"""Variance on each axis of what a pair of fixes errs by beside what it claims: trees and slopes come and go, a receiver
wanders."""


class Sight(NamedTuple):
    """A fix: its time and place (metres north and east of some origin), what it claims, what a lens that is twice as long adds to
    it; GNSS, where that is trusted, less the fix; what the driving velocity came to; by what share the ground seems nearer than
    before, and whether that was before it drifted."""

    t_ns: int
    place_ne_m: Vec2
    cov_ne_m2: Cov2
    per_focal_ne_m: Vec2
    gnss_minus_ne_m: Vec2 | None
    reckoned: Reckoned | None
    nearer: float = 0.0
    before: bool = True


class ScaleDrift:
    """`begun`: pictures drift away in scale. `nearer`: by what share the ground seems nearer since. `odds`: natural logarithm of
    the odds of a lens against ground, as far as that can be told."""

    def __init__(self) -> None:
        self._above: deque[tuple[int, float, float]] = deque()
        self._sights: deque[Sight] = deque()
        self._told: deque[bool] = deque(maxlen=TOLD + SILENT)
        self._away_ns = self._loose_ns = 0
        self._shifted = False
        self.begun = False
        self.before_m = self.nearer = self.odds = 0.0

    def on_fix(self, sight: Sight, above_m: float, sigma_m: float, height_m: float) -> None:
        """Take a fix (its `nearer` is found here), that puts the vehicle so far above the autopilot's height, without what was
        known before and the steps that this has made, and its 1-sigma; and the height flown."""
        self._above.append((sight.t_ns, above_m, sigma_m))
        while self._above[0][0] < sight.t_ns - BEFORE_NS:
            self._above.popleft()
        before = [above for t, above, _ in self._above if t < sight.t_ns - RECENT_NS]
        self._shifted = bool(before) and abs(above_m - median(before)) > BEGUN_SHARE * height_m
        self._drifts(sight.t_ns, height_m)
        off_m = above_m - self.before_m
        self.nearer = height_m / max(height_m / 3, height_m + off_m) - 1 if self.begun else 0.0
        self._sights.append(sight._replace(nearer=self.nearer, before=not self.begun))
        while self._sights[0].t_ns < sight.t_ns - KEPT_NS:
            self._sights.popleft()

    def steady(self, height_m: float) -> bool:
        """Whether heights have stayed for as long as shows the height before a drift: it has ended, elsewhere than it began."""
        heights = [above for _, above, _ in self._above]
        if self._above[-1][0] - self._above[0][0] < BEFORE_NS - RECENT_NS or len(heights) < STEADY:
            return False
        return max(heights) - min(heights) < LEAST_SHARE * height_m

    def told(self, t_ns: int, *, height: bool) -> None:
        """Take that a fix told of the height, or did not."""
        self._told.append(height)
        if self._shifted and list(self._told) == TOLD * [True] + SILENT * [False]:
            self._loose_ns = t_ns + LOOSE_NS

    def loose(self, t_ns: int) -> bool:
        """Whether what was known of the height is to be let loose."""
        return self.begun or t_ns < self._loose_ns

    def _drifts(self, t_ns: int, height_m: float) -> None:
        recent = [(above, sigma) for t, above, sigma in list(self._above)[-NEWEST:] if t >= t_ns - LAST_NS]
        if self.begun:
            if abs(median(above for above, _ in recent) - self.before_m) > LEAST_SHARE * height_m:
                self._away_ns = t_ns
            self.begun = t_ns - self._away_ns < BACK_NS
            if not self.begun:
                self._above = deque(each for each in self._above if each[0] > self._away_ns)
            return
        before = [(above, sigma) for t, above, sigma in self._above if t < t_ns - RECENT_NS]
        if len(before) < FEWEST or len(recent) < NEWEST:
            return
        middle_m, known_m = median(above for above, _ in before), median(sigma for _, sigma in before)
        least = max(BEGUN_SHARE, LEAST_SPREADS * median(abs(above - middle_m) for above, _ in before) / height_m)
        off = [(above - middle_m) / height_m for above, _ in recent]
        claimed = all(abs(above - middle_m) > LEAST_CLAIMS * math.hypot(sigma, known_m) for above, sigma in recent)
        same_way = claimed and (min(off) > least or max(off) < -least)
        if same_way and abs(off[-1]) > max(LEAST_SHARE, least):
            self.begun, self.before_m, self._away_ns = True, middle_m, t_ns
            self._sights = deque(s._replace(before=s.t_ns < t_ns - RECENT_NS) for s in self._sights)

    def newest(self, n: int) -> list[tuple[int, float]]:
        """Times of the last n fixes, and by what share the ground seemed nearer in each."""
        return [(sight.t_ns, sight.nearer) for sight in list(self._sights)[-n:]]

    def tell_apart(self) -> None:
        """Hold the last fixes against earlier ones."""
        now_ns = self._sights[-1].t_ns
        by_age = [[s for s in self._sights if first <= now_ns - s.t_ns < last] for first, last in BANDS_NS]
        before = [s for s in self._sights if s.before][-LAST:]
        self.odds = max((self._of(earlier) for earlier in (*by_age, before)), key=abs)

    def _of(self, earlier: list[Sight]) -> float:
        told, left = [], []
        for now in list(self._sights)[-LAST:]:
            for then in earlier:
                off = _off(then, now)
                if off is not None:
                    odds, squared = _compared(then, now, *off)
                    told.append(odds)
                    left.append(squared)
        if len(told) < LAST * 2:
            return 0.0
        odds = WORTH * fmean(told)
        return 0.0 if odds > 0 and fmean(left) > MOST_LEFT else odds


def _off(then: Sight, now: Sight) -> tuple[FloatArray, float] | None:
    """How much further north and east a fix is off than an earlier one, and what that is not known by, variance on each axis."""
    if now.gnss_minus_ne_m is not None:
        return None if then.gnss_minus_ne_m is None else (np.subtract(then.gnss_minus_ne_m, now.gnss_minus_ne_m), 0.0)
    a, b = then.reckoned, now.reckoned
    if not then.before or a is None or b is None or a.started_ns != b.started_ns or b.drive is not Drive.INERTIAL:
        return None
    dt_s = (now.t_ns - then.t_ns) * 1e-9
    gone = np.subtract(b.travel_ne_m, a.travel_ne_m) - a.carried_ne_m(dt_s)
    return np.subtract(now.place_ne_m, then.place_ne_m) - gone, a.carried_m2(dt_s)


def _compared(then: Sight, now: Sight, off_ne_m: FloatArray, var_m2: float) -> tuple[float, float]:
    """Log of the odds of a lens against ground by a pair of fixes, and what a lens leaves of that, squared in sigmas."""
    by_lens = now.nearer * np.array(now.per_focal_ne_m) - then.nearer * np.array(then.per_focal_ne_m)
    S = np.array(then.cov_ne_m2) + np.array(now.cov_ne_m2) + (var_m2 + OTHER_M2) * np.eye(2)
    left = off_ne_m - by_lens
    return float(by_lens @ np.linalg.solve(S, off_ne_m - by_lens / 2)), float(left @ np.linalg.solve(S, left))
