"""Feeds the filter of the autopilot's height: its heights over time, the priors that were given to localisers, and fixes."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from typing import NamedTuple

from visloc_companion.core.filter.driving import jumped_m
from visloc_companion.core.filter.lasting import apart_m
from visloc_companion.core.filter.votes import looked_at
from visloc_companion.core.heights.height import HeightBelief, HeightFilter, HeightFix, news_of
from visloc_companion.core.remembered import remember
from visloc_companion.core.requests import UNKNOWN_HEIGHT_SIGMA_M, height_sigma_m
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.core.terrain.terrain_aiding import METHOD as TERRAIN
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.types import Fix, GeoPoint, LocaliseRequest, TerrainRequest, Vec2

HISTORY_NS = 10_000_000_000
MAX_GAP_NS = 1_500_000_000
"""Priors kept: one request is outstanding at a time."""
LASTS_NS, LASTS_M = 500_000_000, 1.0
"""Without a new fix an answer stands for so long, and over so much of a climb: the barometer walks 0.07 m meanwhile."""

SAME_JUMP_NS = 1_000_000_000
OTHER_ZERO = 4.0
"""Before any fix a jump beyond so many sigmas of a height is one to another zero, and the height as good as a first one: PX4
begins with an origin at sea level, and has the right one a second later."""
SHOWN_NS, SURE = 2_000_000_000, 3.0
"""What a fix that was taken shows of the height stands for so long; what all of them taught, beyond so many sigmas."""
OVER_GROUND_NS, FAR_ABOVE = 30_000_000_000, 4.0
"""How high a fix that was taken showed the vehicle over the ground stands for so long, and goes on with its climb; so many times
the height of a landing no vehicle is landing, though it is no higher than its home."""
NO_JUMP = (0, 0.0, 0.0)
"""When the height last jumped, by how much since the fix before or a second of calm, and by how much at most."""


class Known(NamedTuple):
    """Of a stated height: what fixes would add to it, the 1-sigma of the sum, and how long no fix has been taken."""

    offset_m: float
    sigma_m: float
    unseen_s: float = math.inf


UNKNOWN = Known(0.0, UNKNOWN_HEIGHT_SIGMA_M)


class Height(NamedTuple):
    """Of a stated height: what fixes would add to it, and the bound of its error."""

    offset_m: float
    protection_level_m: float


class HeightAiding:
    """Height of the autopilot against that of fixes. `drive` starts it. `zeros`: how often it was restarted and then counted from
    another zero."""

    def __init__(self, settings: NavigatorSettings) -> None:
        self._settings = settings
        self._heights: deque[tuple[int, float]] = deque()
        self._priors: dict[int, tuple[float, float]] = {}
        self._filter: HeightFilter | None = None
        self._held: tuple[HeightBelief, int, float, Height] | None = None
        self._above_home_m = 0.0
        self._taken_ns: int | None = None
        self._last_shown: tuple[int, float] | None = None
        self._v_down_mps: float | None = None
        self._jump = NO_JUMP
        self._steps: deque[tuple[int, int, float]] = deque()
        self._stepped_m = 0.0
        self._before_restart_m: float | None = None
        self.zeros = 0
        self._over_ground: tuple[int, float] | None = None
        self._origin: GeoPoint | None = None

    def drive(self, t_ns: int, h_amsl_m: float, above_home_m: float | None, v_down_mps: float | None = None) -> None:
        """The autopilot's height at a time, and its velocity."""
        if self._heights and t_ns <= self._heights[-1][0]:
            return
        if self._heights and self._filter is not None and v_down_mps is not None and self._v_down_mps is not None:
            self._watch(self._filter, t_ns, h_amsl_m, -(v_down_mps + self._v_down_mps) / 2)
        if self._filter is not None and self._before_restart_m is not None:
            sigma_m, step_m = height_sigma_m(above_home_m or 0.0), h_amsl_m - self._before_restart_m
            if abs(step_m) > UNKNOWN_HEIGHT_SIGMA_M:
                offset_m, _ = self._filter.at(t_ns, self._before_restart_m)
                unsure_m = max(UNKNOWN_HEIGHT_SIGMA_M, abs(step_m) / 2)
                self._filter = HeightFilter(self._settings, t_ns, h_amsl_m, unsure_m, offset_m - step_m)
            else:
                self._filter.jumped(t_ns, step_m**2 + sigma_m**2)
            self.zeros += abs(step_m) > sigma_m
            self._before_restart_m = self._last_shown = self._held = None
        self._v_down_mps = v_down_mps
        self._heights.append((t_ns, h_amsl_m))
        while self._heights[0][0] < t_ns - HISTORY_NS:
            self._heights.popleft()
        self._above_home_m = above_home_m or 0.0
        if self._filter is None:
            sigma_m = UNKNOWN_HEIGHT_SIGMA_M if above_home_m is None else height_sigma_m(above_home_m)
            self._filter = HeightFilter(self._settings, t_ns, h_amsl_m, sigma_m)

    def _watch(self, heights: HeightFilter, t_ns: int, h_amsl_m: float, climb_mps: float) -> None:
        """Doubt what fixes have taught where the height changes by more than its climb; what goes there and back before the next
        fix counts once. Where none has taught anything, heights may begin anew."""
        before_ns, before_m = self._heights[-1]
        dt_s = (t_ns - before_ns) * 1e-9
        step_m = jumped_m(h_amsl_m - before_m - climb_mps * dt_s, dt_s)
        if not step_m:
            return
        if t_ns - before_ns <= MAX_GAP_NS:  # over a longer one the climb is known too little
            self._steps.append((before_ns, t_ns, step_m))
        if self._steps and self._steps[0][1] < t_ns - HISTORY_NS:
            self._stepped_m += self._steps.popleft()[2]
        if self._taken_ns is None and abs(step_m) > OTHER_ZERO * height_sigma_m(self._above_home_m):
            self._filter = HeightFilter(self._settings, t_ns, h_amsl_m, height_sigma_m(self._above_home_m))
            self._held, self._jump = None, NO_JUMP
            return
        _, sum_m, most_m = self._jump if t_ns - self._jump[0] < SAME_JUMP_NS else NO_JUMP
        sum_m += step_m
        if abs(sum_m) > most_m:
            heights.jumped(t_ns, sum_m**2 - most_m**2)
            self._held = self._over_ground = None
        self._jump = t_ns, sum_m, max(most_m, abs(sum_m))

    def forget_heights(self, *, restarted: bool = True) -> None:
        """A clock stepped, the next height may bear any time; an autopilot that `restarted` may count from another zero: what
        fixes have taught is doubted by what lies between its last height and the next. No prior is wide enough for a large step:
        then the vehicle is looked for at the height that it had."""
        if restarted and self._heights:
            self._before_restart_m = self._heights[-1][1]
        self._heights.clear()
        self._over_ground = None

    def asked(self, request: LocaliseRequest | TerrainRequest) -> None:
        """Remember which height the localiser was given."""
        remember(self._priors, request.request_id, (request.prior.place.h_amsl_m, request.prior.sigma_h_m))

    def taken(self, fix: Fix, v_ne_mps: Vec2) -> None:
        """A fix that the navigator accepted, and the velocity at which it was taken."""
        stated_m = self._at(fix.t_ns)
        if self._filter is None or stated_m is None:
            return
        self._taken_ns, self._jump = max(fix.t_ns, self._taken_ns or 0), NO_JUMP
        self._last_shown = fix.t_ns, fix.place.h_amsl_m - stated_m
        if fix.above_ground_m is not None:
            self._over_ground = fix.t_ns, fix.above_ground_m - stated_m
        news = self._news(fix)
        if news is not None:
            h_amsl_m, var_m2 = news
            climbed_m = self._filter.climbed_m(stated_m)
            said = h_amsl_m - stated_m, var_m2, climbed_m, fix.method, fix.probability_wrong
            gone_by_per_s = math.hypot(*v_ne_mps) / apart_m(self._above_home_m)
            self._filter.observe(HeightFix(fix.t_ns, fix.request_id, *said, gone_by_per_s, *self._ground(fix)))

    def _news(self, fix: Fix) -> tuple[float, float] | None:
        """Height and variance that a fix adds to the prior of its request. Terrain's is of the soundings alone (`TerrainFix`)."""
        prior = self._priors.get(fix.request_id)
        if prior is None or fix.method == TERRAIN:
            return fix.place.h_amsl_m, fix.sigma_h_m**2
        return news_of(fix.place.h_amsl_m, fix.sigma_h_m, *prior)

    def _ground(self, fix: Fix) -> tuple[Vec2, float]:
        """The ground that a fix looks at, metres north and east of the first one's place, and how far on it is other ground."""
        self._origin = self._origin or fix.place
        north, east, _ = ned_from_geo(fix.place, self._origin)
        (away_north, away_east), spacing_m = looked_at(fix, self._above_home_m)
        return (north + away_north, east + away_east), spacing_m

    def own_m(self, fix: Fix) -> tuple[float, float] | None:
        """By how much a fix alone, without the prior of its request, would raise the autopilot's height, and the 1-sigma of that;
        None where it tells next to nothing of it."""
        stated_m = self._at(fix.t_ns)
        if stated_m is None or fix.request_id not in self._priors:
            return None
        news = self._news(fix)
        return None if news is None else (news[0] - stated_m, math.sqrt(news[1]))

    def learned_m(self, t_ns: int) -> float:
        """By how much fixes have taught to raise the autopilot's height at a time."""
        stated_m = self._at(t_ns)
        return 0.0 if stated_m is None else self.known(t_ns, stated_m).offset_m

    def stepped_m(self, t_ns: int) -> float:
        """What the autopilot's height has changed by until a time beyond its climbs: another sensor states it, and fixes are as
        high as before."""
        since = ((step_m, (t_ns - before_ns) / (after_ns - before_ns)) for before_ns, after_ns, step_m in self._steps)
        return self._stepped_m + sum(step_m * min(1.0, max(0.0, share)) for step_m, share in since)

    def loosen(self, t_ns: int, sigma_m: float) -> None:
        """What fixes taught of the height until a time holds for the next one within this 1-sigma only."""
        if self._filter is not None:
            self._filter.jumped(t_ns, sigma_m**2)

    def hold(self, t_ns: int, offset_m: float, sigma_m: float) -> None:
        """What fixes taught lately was wrong: at a time the autopilot's height had to be raised by so much (1-sigma)."""
        stated_m = self._at(t_ns)
        if stated_m is not None:
            self._filter, self._held = HeightFilter(self._settings, t_ns, stated_m, sigma_m, offset_m), None
            self._last_shown = None

    def known(self, t_ns: int, h_amsl_m: float) -> Known:
        """What is known of a height that is stated at a time: priors of localisers rest on it."""
        if self._filter is None:
            return UNKNOWN
        offset_m, var_m2 = self._filter.at(t_ns, h_amsl_m)
        unseen_s = math.inf if self._taken_ns is None else max(0.0, (t_ns - self._taken_ns) * 1e-9)
        return Known(offset_m, math.sqrt(var_m2), unseen_s)

    def shown_m(self, t_ns: int, h_amsl_m: float) -> float:
        """What the last fix would add to a height that is stated at a time, where that was a moment ago, or else all of them
        beyond doubt; 0 where neither is so."""
        if self._last_shown is not None and abs(t_ns - self._last_shown[0]) <= SHOWN_NS:
            return self._last_shown[1]
        known = self.known(t_ns, h_amsl_m)
        return known.offset_m if abs(known.offset_m) > SURE * known.sigma_m else 0.0

    @property
    def ground_seen(self) -> bool:
        """Whether any fix has shown how far the ground lies below."""
        return self._over_ground is not None

    def far_above_ground(self, t_ns: int, h_amsl_m: float, least_m: float) -> bool:
        """Whether a height that is stated at a time is FAR_ABOVE times as much over the ground that the last fix looked at."""
        above_m = self.above_ground_m(t_ns, h_amsl_m)
        return above_m is not None and above_m >= FAR_ABOVE * least_m

    def above_ground_m(self, t_ns: int, h_amsl_m: float) -> float | None:
        """How high a height that is stated at a time is over the ground that the last fix looked at; None some time later."""
        if self._over_ground is None or abs(t_ns - self._over_ground[0]) > OVER_GROUND_NS:
            return None
        return h_amsl_m + self._over_ground[1]

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
