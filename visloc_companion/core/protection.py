"""The protection levels of a Tick, held against the alert limits of the phase of flight."""

from __future__ import annotations

import math
from typing import NamedTuple

from visloc_companion.core.alert import AlertWatch, Levels, Limits, limits_at
from visloc_companion.core.settings import CoreSettings
from visloc_companion.core.tracking import Tracker
from visloc_companion.types import NavState, Notice


class Protected(NamedTuple):
    """What a stated position is worth: its levels, their limits, what fixes would add to its height, and what follows.

    `alert`: a level counts as beyond its limit. `stopped`: nothing is to be sent. `least_sigma_m`: the least to be claimed.
    """

    levels: Levels
    limits: Limits
    height_offset_m: float | None = None
    alert: bool = False
    stopped: bool = False
    least_sigma_m: float = 0.0

    @property
    def available(self) -> bool:
        """Whether both levels are stated and within their limits."""
        return self.levels.are_within(self.limits)


class Protection:
    """Levels, limits and the alert."""

    def __init__(self, settings: CoreSettings, tracker: Tracker) -> None:
        self._settings, self._tracker = settings.navigator, tracker
        self._watch = AlertWatch(settings.injection.beyond_alert_limit)
        self._sigmas = math.sqrt(-2 * math.log(settings.navigator.integrity_risk))
        self._last = Protected(Levels(None, None), limits_at(None, 0.0, settings.navigator))

    def judge(self, state: NavState | None, now_ns: int) -> Protected:
        """The levels of a state at a time; none without a state."""
        origin = self._tracker.origin
        h_amsl_m = None if state is None or origin is None else origin.h_amsl_m - state.p_ned_m[2]
        height = None if state is None or h_amsl_m is None else self._tracker.height.at(state.t_ns, h_amsl_m)
        levels = Levels(
            None if state is None else self._tracker.protection_level_m(state.t_ns),
            None if height is None else height.protection_level_m,
        )
        offset_m = None if height is None else height.offset_m
        limits = limits_at(self._tracker.height_above_home_m, offset_m or 0.0, self._settings)
        if state is not None:
            self._watch.update(levels, limits, now_ns)
        widened = self._watch.widens and levels.horizontal_m is not None
        least_m = (levels.horizontal_m or 0.0) / self._sigmas if widened else 0.0
        self._last = Protected(levels, limits, offset_m, self._watch.raised, self._watch.stops, least_m)
        return self._last

    def notices(self, *, relied_on: bool, room: bool) -> list[Notice]:
        """What the operator is to be told of what was judged last (alert.AlertWatch.notices)."""
        return self._watch.notices(self._last.levels, relied_on=relied_on, room=room)
