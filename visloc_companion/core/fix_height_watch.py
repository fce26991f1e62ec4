"""Tells once that fixes lie above or below a good GNSS, all by as much: the picture's scale is then not that of the map.

A lens that is longer than calibrated makes the ground seem nearer by the same share, and a map whose heights are of another datum
lifts all fixes alike. Up to some 10 % frames are recognised all the same, and positions and motion err. That is reckoned with
from a few fixes on, which is sooner than they make a good GNSS look false.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import fmean, pstdev

from visloc_companion.types import Command, Fix, Notice, Severity

FEWEST, LEAST_NS, MOST_GAP_NS = 15, 6_000_000_000, 5_000_000_000
"""So many fixes over so long, without a longer pause."""
FIRST_FEW, FIRST_NS = 5, 2_000_000_000
"""Enough to reckon with it."""
LEAST_M, LEAST_SHARE = 7.0, 0.05
"""Receivers, geoids and maps differ by metres; by a share of the height above home only scales do."""
MOST_SPREAD = 0.25
"""1-sigma of the differences over their mean: a wrong scale or datum is there in every fix."""


class FixHeightWatch:
    """Compares each fix that the filter took with the receiver's height. `longer_share`: by how much longer than calibrated the
    lens may be, a share, 0 while nothing speaks for it."""

    def __init__(self) -> None:
        self._told = False
        self.longer_share = 0.0
        self._above: deque[tuple[int, float]] = deque(maxlen=4 * FEWEST)

    def on_fix(self, fix: Fix, gnss_amsl_m: float, height_m: float) -> list[Command]:
        """Take a fix beside a trusted receiver's height, `height_m` above home; what is to be said now."""
        if self._told or height_m <= 0 or not math.isfinite(fix.place.h_amsl_m):
            return []
        if self._above and fix.t_ns - self._above[-1][0] > MOST_GAP_NS:
            self._above.clear()
        self._above.append((fix.t_ns, fix.place.h_amsl_m - gnss_amsl_m))
        n, seen_ns = len(self._above), fix.t_ns - self._above[0][0]
        if n < FIRST_FEW or seen_ns < FIRST_NS:
            return []
        differences = [above for _, above in self._above]
        mean_m = fmean(differences)
        least_m = max(LEAST_M, LEAST_SHARE * height_m)
        if abs(mean_m) < least_m or pstdev(differences) > MOST_SPREAD * abs(mean_m) or height_m + mean_m < height_m / 3:
            return []
        longer = height_m / (height_m + mean_m)
        self.longer_share = self.longer_share or longer - 1
        if n < FEWEST or seen_ns < LEAST_NS:
            return []
        self._told = True
        way = "high" if mean_m > 0 else "low"
        text = f"visloc: fixes {abs(mean_m):.0f} m {way}, fx_px x {longer:.2f}? datum?"
        data = (("above_m", mean_m), ("longer", longer), ("fixes", float(len(differences))))
        return [Notice(Severity.WARNING, text, to_operator=True, data=data)]
