"""Tells once that fixes lie above or below a good GNSS, all by as much: the picture's scale is then not that of the map.

A lens that is longer than calibrated makes the ground seem nearer by the same share, and a map whose heights are of another datum
lifts all fixes alike. Up to some 10 % frames are recognised all the same, and positions and motion err. That is reckoned with
from a few fixes on, which is sooner than they make a good GNSS look false. Ground that the map has too low or high does it as
well, while that is looked at: where other ground shows the lens right the doubt ends, and begins again for no less than is told.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from statistics import fmean, pstdev

from visloc_companion.core.filter.lasting import apart_m
from visloc_companion.geo import wgs84
from visloc_companion.types import Command, Fix, GeoPoint, Notice, Severity

FEWEST, LEAST_NS, MOST_GAP_NS = 15, 6_000_000_000, 5_000_000_000
"""So many fixes over so long, without a longer pause."""
FIRST_FEW, FIRST_NS = 5, 2_000_000_000
"""Enough to reckon with it."""
LEAST_M, LEAST_SHARE = 7.0, 0.05
"""Receivers, geoids and maps differ by metres; by a share of the height above home only scales do."""
MOST_SPREAD = 0.25
"""1-sigma of the differences over their mean: a wrong scale or datum is there in every fix."""
ELSEWHERE, STAYS_NS = 5, 20_000_000_000
"""It is told where the last so many fixes, over other ground than the first (lasting.apart_m), show it as well, or after so long
over one ground."""
RIGHT_SHARE, SPACINGS = 0.5, 10
"""Of what is doubted at least: FEWEST fixes over other ground that lie by less off in the mean show that it was the ground; each
lies that part of the way to other ground (lasting.apart_m) from the one before, so that they look at more than one."""
Seen = tuple[int, float, GeoPoint]
"""A fix: its time, how far it lies above GNSS (m), its place."""


class FixHeightWatch:
    """Compares each fix that the filter took with the receiver's height. `longer_share`: by how much longer than calibrated the
    lens may be, a share, 0 while nothing speaks for it."""

    def __init__(self) -> None:
        self._told = self._was_ground = False
        self.longer_share = 0.0
        self._above: deque[Seen] = deque(maxlen=4 * FEWEST)
        self._since: Seen | None = None
        self._doubted_at: GeoPoint | None = None
        self._elsewhere: deque[Seen] = deque(maxlen=FEWEST)

    def on_fix(self, fix: Fix, gnss_amsl_m: float, height_m: float) -> list[Command]:
        """Take a fix beside a trusted receiver's height, `height_m` above home; what is to be said now."""
        if height_m <= 0 or not math.isfinite(fix.place.h_amsl_m):
            return []
        if self._above and fix.t_ns - self._above[-1][0] > MOST_GAP_NS:
            self._above.clear()
        seen = fix.t_ns, fix.place.h_amsl_m - gnss_amsl_m, fix.place
        self._above.append(seen)
        self._ground_or_lens(seen, height_m)
        n, seen_ns = len(self._above), fix.t_ns - self._above[0][0]
        mean_m = _shown_m(self._above, height_m)
        if mean_m == 0 or n < FIRST_FEW or seen_ns < FIRST_NS:
            self._since = None
            return []
        self._since = self._since or self._above[0]
        lasts = n >= FEWEST and seen_ns >= LEAST_NS and self._is_no_ground(self._since, height_m)
        if self._was_ground and not lasts:
            return []
        longer = height_m / (height_m + mean_m)
        if self.longer_share == 0:
            self.longer_share, self._doubted_at = longer - 1, fix.place
            self._elsewhere.clear()
        if self._told or not lasts:
            return []
        self._told = True
        way = "high" if mean_m > 0 else "low"
        text = f"visloc: fixes {abs(mean_m):.0f} m {way}, fx_px x {longer:.2f}? datum?"
        data = (("above_m", mean_m), ("longer", longer), ("fixes", float(n)))
        return [Notice(Severity.WARNING, text, to_operator=True, data=data)]

    def _is_no_ground(self, since: Seen, height_m: float) -> bool:
        """Whether the last fixes show it over other ground than the first one, or have shown it for long."""
        last = list(self._above)[-ELSEWHERE:]
        away = all(wgs84.distance_m(place, since[2]) >= apart_m(height_m) for _, _, place in last)
        return last[-1][0] - since[0] >= STAYS_NS or (away and _shown_m(last, height_m) != 0)

    def _ground_or_lens(self, seen: Seen, height_m: float) -> None:
        """Doubt the lens no more where other ground shows it right."""
        other_m = apart_m(height_m)
        if self._doubted_at is None or wgs84.distance_m(seen[2], self._doubted_at) < other_m:
            return
        if self._elsewhere and wgs84.distance_m(seen[2], self._elsewhere[-1][2]) < other_m / SPACINGS:
            return
        self._elsewhere.append(seen)
        if len(self._elsewhere) < FEWEST:
            return
        if abs(fmean(above for _, above, _ in self._elsewhere)) < RIGHT_SHARE * _least_m(height_m):
            self.longer_share, self._doubted_at, self._was_ground = 0.0, None, True


def _least_m(height_m: float) -> float:
    return max(LEAST_M, LEAST_SHARE * height_m)


def _shown_m(seen: Sequence[Seen], height_m: float) -> float:
    """By how much fixes lie above GNSS, where they do so by enough and all alike; else 0."""
    differences = [above for _, above, _ in seen]
    mean_m = fmean(differences)
    alike = abs(mean_m) >= _least_m(height_m) and pstdev(differences) <= MOST_SPREAD * abs(mean_m)
    return mean_m if alike and height_m + mean_m >= height_m / 3 else 0.0
