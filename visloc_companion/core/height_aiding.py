"""Feeds the filter of the autopilot's height: its heights over time, the priors that were given to localisers, and fixes."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from dataclasses import dataclass

from visloc_companion.core.height import HeightBelief, HeightFilter, HeightFix, news_of
from visloc_companion.core.remembered import remember
from visloc_companion.core.requests import UNKNOWN_HEIGHT_SIGMA_M, height_sigma_m
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import Fix, LocaliseRequest, TerrainRequest

HISTORY_NS = 10_000_000_000
MAX_GAP_NS = 1_500_000_000
"""Priors kept: one request is outstanding at a time."""
LASTS_NS, LASTS_M = 500_000_000, 1.0
"""Without a new fix an answer stands for so long, and over so much of a climb: the barometer walks 0.07 m meanwhile."""


@dataclass(frozen=True, slots=True)
class Known:
    """Of a stated height: what fixes would add to it, and the 1-sigma of the sum."""

    offset_m: float
    sigma_m: float


UNKNOWN = Known(0.0, UNKNOWN_HEIGHT_SIGMA_M)


@dataclass(frozen=True, slots=True)
class Height:
    """Of a stated height: what fixes would add to it, and the bound of its error."""

    offset_m: float
    protection_level_m: float


class HeightAiding:
    """Height of the autopilot against that of fixes. `drive` starts it."""

    def __init__(self, settings: NavigatorSettings) -> None:
        self._settings = settings
        self._heights: deque[tuple[int, float]] = deque()
        self._priors: dict[int, tuple[float, float]] = {}
        self._filter: HeightFilter | None = None
        self._held: tuple[HeightBelief, int, float, Height] | None = None
        self._above_home_m = 0.0

    def drive(self, t_ns: int, h_amsl_m: float, above_home_m: float | None) -> None:
        """The autopilot's height at a time."""
        if self._heights and t_ns <= self._heights[-1][0]:
            return
        self._heights.append((t_ns, h_amsl_m))
        while self._heights[0][0] < t_ns - HISTORY_NS:
            self._heights.popleft()
        self._above_home_m = above_home_m or 0.0
        if self._filter is None:
            sigma_m = UNKNOWN_HEIGHT_SIGMA_M if above_home_m is None else height_sigma_m(above_home_m)
            self._filter = HeightFilter(self._settings, t_ns, h_amsl_m, sigma_m)

    def forget_heights(self) -> None:
        """The autopilot restarted; its next height may bear any time."""
        self._heights.clear()

    def asked(self, request: LocaliseRequest | TerrainRequest) -> None:
        """Remember which height the localiser was given."""
        remember(self._priors, request.request_id, (request.prior.place.h_amsl_m, request.prior.sigma_h_m))

    def taken(self, fix: Fix) -> None:
        """A fix that the navigator accepted."""
        stated_m = self._at(fix.t_ns)
        if self._filter is None or stated_m is None:
            return
        prior = self._priors.get(fix.request_id)
        news = (fix.place.h_amsl_m, fix.sigma_h_m**2) if prior is None else news_of(fix.place.h_amsl_m, fix.sigma_h_m, *prior)
        if news is not None:
            h_amsl_m, var_m2 = news
            climbed_m = self._filter.climbed_m(stated_m)
            told = HeightFix(fix.t_ns, fix.request_id, h_amsl_m - stated_m, var_m2, climbed_m, fix.method, fix.probability_wrong)
            self._filter.observe(told)

    def known(self, t_ns: int, h_amsl_m: float) -> Known:
        """What is known of a height that is stated at a time: priors of localisers rest on it."""
        if self._filter is None:
            return UNKNOWN
        offset_m, var_m2 = self._filter.at(t_ns, h_amsl_m)
        return Known(offset_m, math.sqrt(var_m2))

    def at(self, t_ns: int, h_amsl_m: float) -> Height | None:
        """What is known of a height that is stated at a time; None before the autopilot stated any."""
        if self._filter is None:
            return None
        if self._held is not None:
            belief, since_ns, since_amsl_m, height = self._held
            lasts = 0 <= t_ns - since_ns < LASTS_NS and abs(h_amsl_m - since_amsl_m) < LASTS_M
            if lasts and belief is self._filter.newest:
                return height
        offset_m, _ = self._filter.at(t_ns, h_amsl_m)
        height = Height(offset_m, self._filter.protection_level_m(t_ns, h_amsl_m, self._above_home_m))
        self._held = (self._filter.newest, t_ns, h_amsl_m, height)
        return height

    def _at(self, t_ns: int) -> float | None:
        """The autopilot's height at a time, between two reports or at the nearest; None where none is near."""
        k = bisect_right(self._heights, t_ns, key=lambda item: item[0])
        near = [self._heights[i] for i in (k - 1, k) if 0 <= i < len(self._heights)]
        near = [item for item in near if abs(item[0] - t_ns) <= MAX_GAP_NS]
        if len(near) < 2:
            return near[0][1] if near else None
        (t0, h0), (t1, h1) = near
        return h0 + (h1 - h0) * (t_ns - t0) / (t1 - t0)
