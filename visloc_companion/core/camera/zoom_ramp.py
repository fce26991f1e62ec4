"""Follows a camera that zooms slowly: heights of fixes show by how much, and frames are looked at through a lens as long.

Until it is known that it is the lens (scale_drift.py), only doubt grows: of the lens as much as heights show, of heights as much
as a quick zoom changes in them between two frames. From then on, or when a lens that was tried is found (zoom_watch.py), heights
are held to what they were before, and each fix says how long the lens is. The one that frames are looked at through goes on in
steps, ahead of what was seen by as long as an answer takes.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from statistics import fmean

from visloc_companion.core.camera.scale_drift import SURE, ScaleDrift, Sight
from visloc_companion.core.camera.unseen_zoom import UnseenZoom
from visloc_companion.core.camera.zoom_watch import NONE_SHARE, ZoomWatch
from visloc_companion.core.filter.lasting import BY_SHAPE
from visloc_companion.core.tracking import Tracker
from visloc_companion.geo import wgs84
from visloc_companion.types import Command, Fix, GeoPoint, Vec2

LOOSE_SHARE = 0.025
"""1-sigma of what a height, over the height flown, changes by from one fix to the next: 5 % a second, twice a second."""
DOUBT_SHARE, DOUBT_STEP, FOLLOWED_SHARE = 0.03, 0.015, 0.03
"""Of the focal length: doubted at least, doubted more where heights show more by so much, and doubted while it is followed."""
NAMED_SHARE = 0.06
"""Less is not taken for a zoom."""
STEP, AHEAD_S = 0.025, 0.7
"""Natural logarithm of a change of the lens, and how far ahead of a frame the next one is."""
RATES, RATE_NS, MOST_PER_S = 5, 3_500_000_000, 0.08
"""Fixes, within so long, that tell how fast it zooms, and the fastest that is believed: natural logarithm."""
LEAST_S = 1.0
"""Over less time, how far it went says nothing of how fast."""
SETTLED_SHARE = 0.01
"""In the end the lens is set right where it is off by more."""
ENDED_NS, LOST_NS, TOLD_SHARE = 5_000_000_000, 10_000_000_000, 0.2
"""Without a change it has ended, without a fix it is not followed any more; until then only such a change is told again."""


class ZoomRamp:
    """`following`: the lens is known to be another one and followed. `unseen`: what it may do while nothing is recognised."""

    def __init__(self, tracker: Tracker, zoom: ZoomWatch) -> None:
        self._tracker, self._zoom = tracker, zoom
        self._drift, self.unseen = ScaleDrift(), UnseenZoom()
        self._origin: GeoPoint | None = None
        self._first = 0, 1.0
        self._ground = self.following = False
        self._before_m = 0.0
        self._ratios: deque[tuple[int, float]] = deque(maxlen=RATES)
        self._changed_ns = self._seen_ns = 0
        self._per_focal_ne_m: Vec2 = (0.0, 0.0)
        self._zeros = tracker.height.zeros

    @property
    def doubting(self) -> bool:
        """Whether pictures drift away in scale, or a zoom is followed: what fixes say beside GNSS is the lens's."""
        return self._drift.begun or self.following

    def stated(self, fix: Fix) -> Vec2:
        """What a lens that is twice as long adds to a fix; structure does not say, the last picture did."""
        return self._per_focal_ne_m if self.doubting and fix.method in BY_SHAPE else fix.per_focal_ne_m

    def on_fix(self, fix: Fix, height_m: float, gnss_minus_ne_m: Vec2 | None, *, taken: bool) -> list[Command]:
        """Take a fix, the height flown, a GNSS that is trusted, less the fix, and whether the filter took it; what is to be said
        now."""
        if height_m <= 0 or fix.method in BY_SHAPE:
            return []
        if self._tracker.height.zeros != self._zeros:
            self._begin_anew()
        own = self._own_m(fix) if taken else None
        told: list[Command] = []
        if own is not None:
            self._per_focal_ne_m = fix.per_focal_ne_m
            told = self._followed(fix, own[0], height_m) if self.following else self._watched(fix, own, height_m, gnss_minus_ne_m)
        self._drift.told(fix.t_ns, height=own is not None)
        if not self.following and self._drift.loose(fix.t_ns):
            self._tracker.height.loosen(fix.t_ns + 1, LOOSE_SHARE * height_m)
        return told

    def _own_m(self, fix: Fix) -> tuple[float, float] | None:
        """By how much a fix alone would raise the autopilot's height if that had made no steps, and its 1-sigma."""
        own = self._tracker.height.own_m(fix)
        return None if own is None else (own[0] + self._tracker.height.stepped_m(fix.t_ns), own[1])

    def _begin_anew(self) -> None:
        """The autopilot was restarted: its height from another zero is no change of the picture's scale, nor are those of before
        any to be held to. A lens that was followed stays as long as it was."""
        self._zeros, self.following = self._tracker.height.zeros, False
        self._drift = ScaleDrift()
        self._over()

    def _watched(self, fix: Fix, own_m: tuple[float, float], height_m: float, gnss_minus_ne_m: Vec2 | None) -> list[Command]:
        drift, tracker = self._drift, self._tracker
        self._origin = fix.place if self._origin is None else self._origin
        north, east, _ = wgs84.ned_from_geo(fix.place, self._origin)
        begun = drift.begun
        sight = Sight(fix.t_ns, (north, east), fix.cov_ne_m2, fix.per_focal_ne_m, gnss_minus_ne_m, tracker.reckoned(fix.t_ns))
        drift.on_fix(sight, *own_m, height_m)
        if not drift.begun:
            self._first = fix.t_ns, self._zoom.factor
            self.unseen.clear()
            if begun:
                self._over()
            return []
        drift.tell_apart()
        if drift.odds < -SURE and not self._ground:
            self._ground = True
            tracker.know_lens(0.0)
        if self._ground and drift.steady(height_m):
            self._drift, self._ground = ScaleDrift(), False
            return []
        if drift.odds > SURE and abs(drift.nearer) > NAMED_SHARE:
            return self._begin(fix, height_m)
        self._ground &= drift.odds < SURE
        share = max(DOUBT_SHARE, abs(drift.nearer))
        if not self._ground and share > abs(tracker.longer_share) + (DOUBT_STEP if tracker.longer_share else 0.0):
            tracker.doubt_lens(fix, math.copysign(share, drift.nearer))
        return []

    def _over(self) -> None:
        self._ground = False
        if self._tracker.longer_share:
            self._tracker.know_lens(0.0)

    def _begin(self, fix: Fix, height_m: float) -> list[Command]:
        """It is the lens: heights are what they were before."""
        self._follow(fix.t_ns, self._drifted(), self._drift.before_m, height_m)
        self._change(fix.t_ns)
        return self._zoom.tell()

    def _drifted(self) -> list[tuple[int, float]]:
        """The zoom of the last fixes, as far as it is the lens."""
        return [(t_ns, self._zoom.factor * (1 + nearer)) for t_ns, nearer in self._drift.newest(RATES)]

    def found(self, t_ns: int) -> None:
        """Frames are recognised through a lens that was tried: it may go on."""
        height = self._tracker.height
        learned_m = height.learned_m(t_ns) + height.stepped_m(t_ns)
        before_m = self._before_m if self.following else self._drift.before_m if self._drift.begun else learned_m
        if not self.doubting:
            self._first = t_ns, self._zoom.factor
        self._follow(t_ns, [(t_ns, self._zoom.factor)], before_m, self._tracker.height_above_home_m or 0.0)

    def _follow(self, t_ns: int, ratios: list[tuple[int, float]], before_m: float, height_m: float) -> None:
        self.following, self._before_m = True, before_m
        self._changed_ns = self._seen_ns = t_ns
        self._ratios.clear()
        self._ratios.extend(ratios)
        self._drift = ScaleDrift()
        self.unseen.seen(t_ns, self._fastest(ratios))
        height = self._tracker.height
        height.hold(t_ns, before_m - height.stepped_m(t_ns), LOOSE_SHARE * abs(height_m))
        self._tracker.know_lens(FOLLOWED_SHARE)

    def _followed(self, fix: Fix, own_m: float, height_m: float) -> list[Command]:
        asked = self._zoom.asked_zoom(fix.request_id)
        if asked is None:
            return []
        self._seen_ns = fix.t_ns
        self._ratios.append((fix.t_ns, asked * height_m / max(height_m / 3, height_m + own_m - self._before_m)))
        self.unseen.seen(fix.t_ns, self._fastest(self._ratios))
        if abs(math.log(self._ahead(fix.t_ns) / self._zoom.factor)) > STEP:
            self._change(fix.t_ns)
            return self._zoom.tell(TOLD_SHARE)
        if fix.t_ns - self._changed_ns <= ENDED_NS:
            return []
        self.unseen.clear()
        return self._end()

    def _change(self, t_ns: int) -> None:
        self._changed_ns = t_ns
        self._zoom.follow(self._ahead(t_ns))

    def _end(self) -> list[Command]:
        self.following = False
        factor = math.exp(fmean(math.log(ratio) for _, ratio in self._ratios))
        if abs(math.log(factor)) < NONE_SHARE:
            factor = 1.0
        if abs(math.log(factor / self._zoom.factor)) > SETTLED_SHARE:
            self._zoom.follow(factor)
        self._tracker.know_lens(0.0)
        return self._zoom.tell()

    def check(self, now_ns: int) -> list[Command]:
        """A frame was not recognised: how long the lens may be by now, and whether that is too long ago to say."""
        if self.following and now_ns - self._seen_ns > LOST_NS:
            return self._end()
        self._zoom.expect(self._ahead(now_ns) if self.following else None)
        self._zoom.goes_on_unseen = self.unseen.goes_on(now_ns)
        return []

    def _ahead(self, t_ns: int) -> float:
        """The zoom at the next frame after a time."""
        (mean_s, mean), rate = _recent(self._ratios)
        return math.exp(mean + rate * ((t_ns - self._ratios[-1][0]) * 1e-9 + AHEAD_S - mean_s))

    def _fastest(self, ratios: Sequence[tuple[int, float]]) -> float:
        """How fast the lens may go on by its last ratios, natural logarithm a second: as lately, or as since it was last as long
        as before, if that was faster (one that goes in steps stands still in between)."""
        (first_ns, first), (newest_ns, newest) = self._first, ratios[-1]
        seconds = max(LEAST_S, (newest_ns - first_ns) * 1e-9)
        return max(abs(_recent(ratios)[1]), min(MOST_PER_S, abs(math.log(newest / first)) / seconds))


def _recent(ratios: Sequence[tuple[int, float]]) -> tuple[tuple[float, float], float]:
    """Of the last ratios: their mean time since the newest, seconds, and logarithm, and how fast that goes on, a second."""
    newest_ns = ratios[-1][0]
    recent = [(t, ratio) for t, ratio in ratios if t >= newest_ns - RATE_NS]
    t_s = [(t - newest_ns) * 1e-9 for t, _ in recent]
    logs = [math.log(ratio) for _, ratio in recent]
    mean_s, mean = fmean(t_s), fmean(logs)
    spread = sum((t - mean_s) ** 2 for t in t_s)
    rate = sum((t - mean_s) * log for t, log in zip(t_s, logs, strict=True)) / spread if spread > 0.25 else 0.0
    return (mean_s, mean), max(-MOST_PER_S, min(MOST_PER_S, rate))
