"""Finds a camera that zoomed in flight: frames that were recognised are not any more, but are through a lens of another length.

Odometry measures in focal lengths, too, so a zoom moves it unlike GNSS, which a false GNSS does as well. But that leaves frames
as recognisable as they were. So once frames cease to be recognised every other one is looked at as if it were enlarged: first as
much as odometry moves more than GNSS, or than the vehicle did before, then by all that a camera may do. That comes beside what is
made of the frame otherwise: a false GNSS is found as soon as ever. Three fixes that agree on the place, and by their height on
the enlargement, decide.

Ground that is nearer than the map says (woods, hills that it does not show) looks larger, too. It comes into view little by
little: the last frames that were recognised were off in height by some percent already. After those nothing is tried.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import NamedTuple

from visloc_companion.core.camera.zoom_tries import ZoomTries
from visloc_companion.core.filter.motion import Motion
from visloc_companion.core.satellites.gnss_track import GnssTrack
from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.types import Command, Fix, LocaliseRequest, NoFix, Notice, Odometry, Severity, Vec2

UNLIKE_THE_MAP = (
    Reason.NO_MATCH,
    Reason.AMBIGUOUS,
    Reason.BLOCKS_DISAGREE,
    Reason.INCONSISTENT_WITH_PRIOR,
    Reason.REFINEMENT_DIVERGED,
    Reason.TOO_FEW_FEATURES,
    Reason.POSE_FAILED,
)
"""What is said of a picture that shows something."""
MISSES, MOST_MISSES, LEAST_NS = 3, 6, 1_200_000_000
"""Frames that were not recognised, less as many for each that was, and how long ago the last one was."""
MOTIONS, LEAST_WAY_M = 4, 4.0
HITS, MOST_MISSED = 3, 2
"""Fixes that decide, and frames without any in between."""
ALIKE, PLACE_M, PLACE_MPS = 0.04, 5.0, 3.0
"""By what share their enlargements may differ, and how far they may lie apart beside the way that is believed: odometry has
carried the place on by the wrong lens, which may double the speed."""
TELL_SHARE, NONE_SHARE = 0.08, 0.04
"""A change that is told and reckoned with; so near to the calibrated lens it is that one: heights err by as much."""
HEIGHTS, LEAST_HEIGHTS, LAST, SUDDEN_SHARE = 8, 5, 2, 0.03
"""Fixes whose heights are remembered, and so many at least: before, it may be map or set-up that show nothing; the last ones of
them, and by how much these may differ from those before."""


FAR_BETTER, LEAST_RIGHT = 3.0, 1e-6
"""Nats by which a look through a lens that is tried has to have better odds of being right than that through the believed one,
and the least probability that is told apart. Over NAIP rows < 400, footprints of 64 px, priors of 2 % of the height: wrong lenses
that were accepted where the right one was declined had 2.0 or less; right ones, beside a belief that is 20 to 33 % off, had 3 and
more in 65 of 77 cases."""
DOUBTED_NS, DOUBTED_MPS, DOUBTED_SHARE = 6_000_000_000, 1.5, 0.15
"""Since the last frame that was recognised; of a change of speed."""


class _Hit(NamedTuple):
    """A fix: its time, the enlargement by its height, that against the height as it was stated, without what fixes taught of it,
    and where it lies beside the prior, metres."""

    t_ns: int
    factor: float
    as_stated: float
    beside_ne_m: Vec2


class ZoomWatch:
    """`factor`: by how much pictures are enlarged beyond the calibrated lens, as far as is known."""

    def __init__(self) -> None:
        self.factor = 1.0
        self._told = 1.0
        self._misses = 0
        self._fix_ns, self._speed_mps = 0, 0.0
        self._motions: deque[Motion] = deque(maxlen=MOTIONS)
        self._tries = ZoomTries()
        self._asked: tuple[LocaliseRequest, float] | None = None
        self._trying: float | None = None
        self._hits: list[_Hit] = []
        self._missed = 0
        self._expected: float | None = None
        self.goes_on_unseen = False
        """Whether a zoom that was followed may have gone on since the last fix, nobody knows how far."""
        self.found: Fix | None = None
        """The newest fix through the lens that was found to be there."""
        self._heights: deque[float] = deque(maxlen=HEIGHTS)

    @property
    def recognised_ns(self) -> int:
        """When a frame was recognised last, through the lens that was believed then."""
        return self._fix_ns

    def moved(self, seen: Motion) -> None:
        """Take an interval of odometry, which goes by the believed lens."""
        if self._misses:
            self._motions.append(seen)

    def doubts(self, motion: Odometry) -> bool:
        """Whether odometry of a frame that was not recognised is not to be relied on: suddenly the vehicle seems to be faster or
        slower by as much as a zoom makes it. Until it is found, or is not, accelerations tell the velocity well enough."""
        seconds = (motion.t_to_ns - motion.t_from_ns) * 1e-9
        change_mps = math.hypot(*motion.displacement_ned_m[:2]) / seconds - self._speed_mps
        sudden = motion.t_to_ns - self._fix_ns < DOUBTED_NS and self._sudden
        return sudden and abs(change_mps) > max(DOUBTED_MPS, DOUBTED_SHARE * self._speed_mps)

    def next(self, now_ns: int, gnss: GnssTrack) -> float | None:
        """How the next frame is to be looked at as well where it is not recognised."""
        before, self._trying = self._trying, None
        if self._hits:
            self._trying = before
        elif before is None and self._misses >= MISSES and now_ns - self._fix_ns >= LEAST_NS and self._may_have:
            more = self._tries.next(now_ns, self._guess(gnss), 1 / self.factor)
            self._trying = None if more is None else self.factor * more
        return self._trying

    @property
    def _may_have(self) -> bool:
        """Whether it may be a zoom that hides the ground."""
        return self._expected is not None or self.goes_on_unseen or self._sudden

    def _guess(self, gnss: GnssTrack) -> float | None:
        return self._more(gnss) if self._expected is None else self._expected / self.factor

    @property
    def _sudden(self) -> bool:
        """Whether the last frames that were recognised were as high as those before."""
        heights = list(self._heights)
        if len(heights) < LEAST_HEIGHTS:
            return False
        before = median(heights[:-LAST])
        return all(abs(math.log(last / before)) < SUDDEN_SHARE for last in heights[-LAST:])

    def asked_zoom(self, request_id: int) -> float | None:
        """Through which lens the frame of a request was looked at; None for one that is not the last."""
        asked = self._request(request_id)
        return None if asked is None else asked.zoom

    def _request(self, request_id: int) -> LocaliseRequest | None:
        """The last request, where that is it."""
        asked = None if self._asked is None else self._asked[0]
        return asked if asked is not None and asked.request_id == request_id else None

    def follow(self, factor: float) -> None:
        """Fixes that are recognised show that the enlargement is another one by now."""
        self.factor = factor
        self._clear()

    def expect(self, factor: float | None) -> None:
        """The enlargement that comes first where frames are not recognised."""
        self._expected = factor

    def asked(self, request: LocaliseRequest, height_m: float) -> None:
        """The worker is asked; `height_m`: of the vehicle above home."""
        self._asked = request, height_m

    def answered(self, answer: Fix | NoFix, speed_mps: float) -> list[Command]:
        """Take an answer and the vehicle's speed; what is to be said where the lens is found to be another: `factor` has changed
        then."""
        if isinstance(answer, NoFix):
            if answer.reason in UNLIKE_THE_MAP:
                self._misses = min(MOST_MISSES, self._misses + 1)
            tried = self._trying if self._request(answer.request_id) is not None else None
            return [] if tried is None else self._tried(answer, tried)
        hit = self._hit(answer, self.factor)
        if hit is not None and self._misses == 0:
            self._heights.append(hit.as_stated)
        self._misses, self._hits = max(0, self._misses - MISSES), []
        if self._misses == 0:
            self._fix_ns, self._speed_mps = answer.t_ns, speed_mps
            self._motions.clear()
            self._tries.clear()
        return []

    def _tried(self, answer: NoFix, zoom: float) -> list[Command]:
        fix = answer.zoomed
        hit = None if fix is None or better_by(fix, answer) < FAR_BETTER else self._hit(fix, zoom)
        if hit is None:
            self._missed += 1
            if self._missed > MOST_MISSED:
                self._hits = []
            return []
        self._missed = 0
        self._hits = [*(before for before in self._hits if self._agree(before, hit)), hit]
        if len(self._hits) < HITS:
            return []
        factor = median(each.factor for each in self._hits)
        if abs(math.log(factor / self.factor)) < TELL_SHARE:
            self._hits = []
            self._tries.exhausted(hit.t_ns)
            return []
        self.found = fix
        return self._changed(factor)

    def _changed(self, factor: float) -> list[Command]:
        self.follow(1.0 if abs(math.log(factor)) < NONE_SHARE else factor)
        return self.tell()

    def _clear(self) -> None:
        self._hits, self._misses = [], 0
        self._heights.clear()
        self._motions.clear()
        self._tries.clear()

    def tell(self, least: float = TELL_SHARE) -> list[Command]:
        """What is to be said of the enlargement where it is another one, by a share, than was told before."""
        before = self._told
        if abs(math.log(self.factor / before)) < least and (self.factor != 1.0 or before == 1.0):
            return []
        self._told = self.factor
        if self.factor == 1.0:
            return [Notice(Severity.NOTICE, "visloc: camera zoom is back to normal", to_operator=True)]
        text = f"visloc: camera zoomed x {self.factor:.2f}, or height off?"
        return [Notice(Severity.WARNING, text, to_operator=True, data=(("factor", self.factor),))]

    def _more(self, gnss: GnssTrack) -> float | None:
        """How many times as far as the vehicle moves odometry does; None where that is not known."""
        seen_m = moved_m = 0.0
        for motion in self._motions:
            moved_ne_m = gnss.displacement(motion.t_from_ns, motion.t_ns)
            by_gnss_m = None if moved_ne_m is None else math.hypot(*moved_ne_m)
            moved_m += self._speed_mps * motion.duration_s if by_gnss_m is None else by_gnss_m
            seen_m += math.hypot(*motion.d_ne_m)
        return None if moved_m < LEAST_WAY_M or seen_m < LEAST_WAY_M / 2 else seen_m / moved_m

    def _hit(self, fix: Fix, zoom: float) -> _Hit | None:
        """What a fix says of the enlargement; the ground seems nearer through a longer lens."""
        asked = self._asked
        if asked is None or asked[0].request_id != fix.request_id:
            return None
        (request, height_m), prior = asked, asked[0].prior.place
        above_m = fix.place.h_amsl_m - prior.h_amsl_m
        above_stated_m = above_m + request.prior.height_offset_m
        if not min(height_m, height_m + above_m, height_m + above_stated_m) > 0:
            return None
        north, east, _ = wgs84.ned_from_geo(fix.place, prior)
        factor, as_stated = (zoom * height_m / (height_m + above) for above in (above_m, above_stated_m))
        return _Hit(fix.t_ns, factor, as_stated, (north, east))

    def _agree(self, a: _Hit, b: _Hit) -> bool:
        within_m = PLACE_M + (PLACE_MPS + self._speed_mps) * abs(b.t_ns - a.t_ns) * 1e-9
        return abs(math.log(a.factor / b.factor)) < ALIKE and math.dist(a.beside_ne_m, b.beside_ne_m) < within_m


def better_by(fix: Fix, declined: NoFix) -> float:
    """Nats by which the odds of a fix are better than those that one of the places is right which the refusal leaves open; none
    is where these would have the camera at another place, height or attitude than it is known to have."""
    contradicted = declined.reason is Reason.INCONSISTENT_WITH_PRIOR
    as_believed = 0.0 if contradicted else sum(math.exp(place.log_evidence) for place in declined.open_places)
    return _log_odds(1 - fix.probability_wrong) - _log_odds(as_believed)


def _log_odds(right: float) -> float:
    right = min(1 - LEAST_RIGHT, max(LEAST_RIGHT, right))
    return math.log(right / (1 - right))
