"""Eyes of flights without pictures that err as a real localiser does where the autopilot's heading or height, GNSS or sight fail.

As consistency_eyes.py, and: within `Spell`s there is no sight, no fix, or a fix that is wrong in one and the same way. A heading
or height beyond REFUSED_SIGMA of the prior is refused (localise/verify.py). Odometry is turned by the autopilot's heading, set
right by that of the last HEADINGS fixes and then sure to LEARNED_RAD (localise/odometry/true_heading.py; no turns are seen that
would carry it on), and stretched by its height.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from statistics import median
from typing import Literal

import numpy as np

from benchmarks.flown.consistency_eyes import BLANK, HEIGHT_SIGMA_M, KnowingEyes
from visloc_companion.errors import Reason
from visloc_companion.geo import se3, wgs84
from visloc_companion.protocols import ReferenceMap
from visloc_companion.sim.odometry_model import LEG_SIGMA_M, SCALE_SIGMA
from visloc_companion.sim.rendering.render_motion import STILL, Shot
from visloc_companion.types import Fix, GeoPoint, Image, LocaliseRequest, NoFix, Odometry, PosePrior, Quat, Vec2

REFUSED_SIGMA = 4.5
HEADINGS, HEADING_AGE_NS, LEARNED_RAD = 5, 60_000_000_000, math.radians(1.0)
LEAST_HEIGHT_M = 30.0


@dataclass(frozen=True, slots=True)
class Spell:
    """From `start_s` to `end_s` of the flight nothing is seen (`blind`), nothing is found on the map (`no_fix`), or the image's
    fixes are off by `off_ne_m`, as far as that place is searched (`wrong`)."""

    kind: Literal["blind", "no_fix", "wrong"]
    start_s: float
    end_s: float
    off_ne_m: Vec2 = (0.0, 0.0)


@dataclass(slots=True)
class FaultyEyes(KnowingEyes):
    """Camera and localiser of one flight. `start_ns` is its beginning on the frames' clock, `home_amsl_m` the ground."""

    spells: Sequence[Spell] = ()
    start_ns: int = 0
    home_amsl_m: float = 0.0
    _seen_from: tuple[GeoPoint, Quat] | None = None
    _headings: list[tuple[int, float]] = field(default_factory=list)

    def render(self, place: GeoPoint, q_ned_frd: Quat, frame_id: int, shot: Shot = STILL) -> Image:
        """Remembers from where the frame is that is localised next; a frozen camera's is of earlier."""
        self._seen_from = place, q_ned_frd
        return BLANK

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The truth, with errors; what is refused gives no fix."""
        assert self._seen_from is not None, "a frame is rendered before it is localised"
        place, q_ned_frd = self._seen_from
        frame, prior = request.frame, request.prior
        if self._last_ns is None or frame.t_ns > self._last_ns:
            self._wander(frame.t_ns)
        about = (frame.t_rx_ns, frame.t_ns, request.request_id, frame.frame_id, self.method)
        if self._spell("blind", frame.t_ns) is not None:
            self._odometry.lose()
            return NoFix(*about, Reason.LOW_TEXTURE, 60.0)
        heading_rad = math.remainder(_yaw_rad(prior.q_ned_frd) - _yaw_rad(q_ned_frd), 2 * math.pi)
        up_m = prior.place.h_amsl_m - place.h_amsl_m
        motion = self._moved(frame.t_ns, place, heading_rad, up_m, prior)
        if self._spell("no_fix", frame.t_ns) is not None or self._rng.random() > self.model_.fix_share:
            return NoFix(*about, Reason.NO_MATCH, 60.0, motion=motion)
        height_sigmas = abs(up_m) / math.hypot(prior.sigma_h_m, HEIGHT_SIGMA_M)
        if max(abs(heading_rad) / prior.sigma_yaw_rad, height_sigmas) > REFUSED_SIGMA:
            return NoFix(*about, Reason.INCONSISTENT_WITH_PRIOR, 60.0, motion=motion)
        at = self._found(request, place)
        if at is None:
            return NoFix(*about, Reason.NO_MATCH, 60.0, motion=motion)
        seen, sigma_m, claim = at
        self._headings = [*self._headings, (frame.t_ns, heading_rad)][-HEADINGS:]
        cov = ((sigma_m**2, 0.0), (0.0, sigma_m**2))
        sigma_h_m = (prior.sigma_h_m**-2 + HEIGHT_SIGMA_M**-2) ** -0.5
        return Fix(*about, seen, prior.q_ned_frd, cov, sigma_h_m, 0.02, claim, 60.0, motion=motion)

    def _found(self, request: LocaliseRequest, place: GeoPoint) -> tuple[GeoPoint, float, float] | None:
        """Where the camera is found to be, with the 1-sigma and the probability of being wrong that are claimed; None where that
        place is not searched."""
        spell = self._spell("wrong", request.frame.t_ns)
        off, sigma_m, claim = self._erring(request, place, None if spell is None else spell.off_ne_m)
        (nn, _), (_, ee) = request.prior.cov_ne_m2
        height_m = max(LEAST_HEIGHT_M, place.h_amsl_m - self.home_amsl_m)
        reach_m = 3 * math.hypot(math.sqrt(max(nn, ee)), request.prior.sigma_tilt_rad * height_m)
        away_m = np.hypot(*(np.array(wgs84.ned_from_geo(place, request.prior.place)[:2]) + off))
        if away_m > reach_m + 3 * sigma_m:
            return None
        up_m = self._height_found(request.prior, place.h_amsl_m) - place.h_amsl_m
        return wgs84.geo_from_ned((float(off[0]), float(off[1]), -up_m), place), sigma_m, claim

    def _height_found(self, prior: PosePrior, true_amsl_m: float) -> float:
        """Between what the picture shows and the prior, as their sigmas have it."""
        shown_m = true_amsl_m + float(HEIGHT_SIGMA_M * self._rng.standard_normal())
        share = prior.sigma_h_m**2 / (prior.sigma_h_m**2 + HEIGHT_SIGMA_M**2)
        return prior.place.h_amsl_m + share * (shown_m - prior.place.h_amsl_m)

    def _moved(self, t_ns: int, place: GeoPoint, heading_rad: float, up_m: float, prior: PosePrior) -> Odometry | None:
        """The way since the keyframe, turned by a heading and stretched by a height that are off by so much."""
        seen = self._motion(t_ns, place)
        if seen is None:
            return None
        recent = [heading for at_ns, heading in self._headings if 0 <= t_ns - at_ns <= HEADING_AGE_NS]
        learned = len(recent) == HEADINGS
        turn, sigma_rad = (heading_rad - median(recent), LEARNED_RAD) if learned else (heading_rad, prior.sigma_yaw_rad)
        height_m = max(LEAST_HEIGHT_M, place.h_amsl_m - self.home_amsl_m)
        sigma_scale = math.hypot(SCALE_SIGMA, prior.sigma_h_m / height_m)
        (north, east, down), c, s = seen.displacement_ned_m, math.cos(turn), math.sin(turn)
        north, east = ((1 + up_m / height_m) * d for d in (c * north - s * east, s * north + c * east))
        nn = LEG_SIGMA_M**2 + (sigma_scale * north) ** 2 + (sigma_rad * east) ** 2
        ee = LEG_SIGMA_M**2 + (sigma_scale * east) ** 2 + (sigma_rad * north) ** 2
        ne = (sigma_scale**2 - sigma_rad**2) * north * east
        moved, cov = (north, east, down), ((nn, ne), (ne, ee))
        return replace(seen, displacement_ned_m=moved, cov_ne_m2=cov, sigma_scale=sigma_scale, sigma_heading_rad=sigma_rad)

    def _spell(self, kind: str, t_ns: int) -> Spell | None:
        t_s = (t_ns - self.start_ns) * 1e-9
        return next((spell for spell in self.spells if spell.kind == kind and spell.start_s <= t_s < spell.end_s), None)


def _yaw_rad(q_ned_frd: Quat) -> float:
    return se3.euler_from_quat(q_ned_frd)[2]
