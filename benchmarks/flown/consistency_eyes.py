"""Eyes for flights without pictures: they know the truth, and err as localiser and odometry claim to err.

A fix is off by as much as it claims and by the map's own error. LASTING_SHARE of the claimed variance is that of the ground which
neighbouring frames look at and lasts GROUND_TAU_S. The map's error wanders along the track with the 1-sigma `map_sigma_m` and a
correlation of MAP_TAU_S. It is a wrong match as often as it claims, anywhere in the search region, and stays wrong in the same
way over the same ground (same_ground.py). Odometry: sim/odometry_model.py. Where sight comes and goes, stretches without fixes
and odometry take turns with others, each of a random length.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from benchmarks.flown.claims import claimed
from benchmarks.flown.same_ground import Match, anywhere_m, lasts_m
from visloc_companion.core.filter.lasting import SHARE as LASTING_SHARE
from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.protocols import ReferenceMap
from visloc_companion.sim.odometry_model import OdometryModel
from visloc_companion.sim.rendering.render_motion import STILL, Shot
from visloc_companion.types import (
    CameraModel,
    Fix,
    FloatArray,
    GeoPoint,
    Image,
    LocaliseRequest,
    NoFix,
    Odometry,
    PosePrior,
    Quat,
    Vec2,
    Vec3,
)

MAP_TAU_S, GROUND_TAU_S = 15.0, 5.0
SIGMA_M = (0.3, 1.2)
HEIGHT_SIGMA_M = 1.5
MODEL = CameraModel(64, 48, 50.0, 50.0, 31.5, 23.5)
BLANK: Image = np.zeros((48, 64), np.uint8)


@dataclass(frozen=True, slots=True)
class EyesModel:
    """What is seen: a fix for this share of the frames, odometry or not, wrong matches or none."""

    fix_share: float = 0.9
    odometry: bool = True
    wrong: bool = True
    overconfident: float = 1.0
    """Claimed sigma over true sigma is one over this."""
    seeing_s: float = math.inf
    blind_s: float = 0.0
    """Mean lengths of the stretches with sight and without."""


@dataclass(slots=True)
class KnowingEyes:
    """Camera and localiser of one flight (sim.flight_log.Eyes wants both)."""

    model_: EyesModel
    seed: int
    map_sigma_m: float
    model: CameraModel = MODEL
    method: str = "deep"
    _rng: np.random.Generator = field(init=False)
    _map_m: FloatArray = field(init=False)
    _ground: FloatArray = field(init=False)
    _odometry: OdometryModel = field(init=False)
    _origin: GeoPoint | None = None
    _places: dict[int, tuple[GeoPoint, Quat]] = field(default_factory=dict)
    _match: Match = field(init=False)
    _looked_ned_m: Vec3 = (0.0, 0.0, 0.0)
    _last_ns: int | None = None
    _sights: np.random.Generator = field(init=False)
    _sees: bool = True
    _turns_ns: int | None = None

    def __post_init__(self) -> None:
        self._rng, self._sights = np.random.default_rng([self.seed, 77]), np.random.default_rng([self.seed, 78])
        self._map_m = self.map_sigma_m * self._rng.standard_normal(2)
        self._ground = self._rng.standard_normal(2)
        self._odometry = OdometryModel.drawn(self._rng)
        self._match = Match(self.method)

    def render(self, place: GeoPoint, q_ned_frd: Quat, frame_id: int, shot: Shot = STILL) -> Image:
        """Remembers from where the frame is."""
        self._places = {frame_id: (place, q_ned_frd)}
        return BLANK

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The truth, with errors."""
        frame = request.frame
        place, q_ned_frd = self._places[frame.frame_id]
        self._wander(frame.t_ns)
        about = (frame.t_rx_ns, frame.t_ns, request.request_id, frame.frame_id, self.method)
        if not self._sighted(frame.t_ns):
            self._odometry.lose()
            return NoFix(*about, Reason.LOW_TEXTURE, 60.0)
        motion = self._motion(frame.t_ns, place)
        if self._rng.random() > self.model_.fix_share:
            return NoFix(*about, Reason.NO_MATCH, 60.0, motion=motion)
        off, sigma, claim = self._erring(request, place)
        seen = wgs84.geo_from_ned((float(off[0]), float(off[1]), float(HEIGHT_SIGMA_M * self._rng.standard_normal())), place)
        var = (sigma / self.model_.overconfident) ** 2
        cov = ((var, 0.0), (0.0, var))
        return Fix(*about, seen, q_ned_frd, cov, HEIGHT_SIGMA_M, 0.02, claim, 60.0, motion=motion)

    def _erring(
        self, request: LocaliseRequest, place: GeoPoint, wrong_by_m: Vec2 | None = None
    ) -> tuple[FloatArray, float, float]:
        """By how much (2,) a fix is off, the 1-sigma that is meant by that, and the probability of being wrong that it claims;
        `wrong_by_m`: of one that is wrong for certain."""
        claim = claimed(self._rng)
        mistaken_m = self._mistaken(claim, request, place)
        sigma = float(self._rng.uniform(*SIGMA_M))
        matched = math.sqrt(LASTING_SHARE) * self._ground + math.sqrt(1 - LASTING_SHARE) * self._rng.standard_normal(2)
        off = self._map_m + sigma * matched + (0.0 if mistaken_m is None else mistaken_m)
        return (off if wrong_by_m is None else self._map_m + sigma * matched + np.array(wrong_by_m)), sigma, claim

    def _sighted(self, t_ns: int) -> bool:
        """Whether anything is seen at a time, which is not before the last one asked about."""
        if self.model_.blind_s == 0.0:
            return True
        while self._turns_ns is None or t_ns >= self._turns_ns:
            self._sees = self._turns_ns is None or not self._sees
            mean_s = self.model_.seeing_s if self._sees else self.model_.blind_s
            self._turns_ns = (t_ns if self._turns_ns is None else self._turns_ns) + round(self._sights.exponential(mean_s) * 1e9)
        return self._sees

    def _wander(self, t_ns: int) -> None:
        dt_s = 0.0 if self._last_ns is None else (t_ns - self._last_ns) * 1e-9
        self._last_ns = t_ns
        self._map_m = _gone_on(self._map_m, self.map_sigma_m, math.exp(-dt_s / MAP_TAU_S), self._rng)
        self._ground = _gone_on(self._ground, 1.0, math.exp(-dt_s / GROUND_TAU_S), self._rng)

    def _mistaken(self, claim: float, request: LocaliseRequest, place: GeoPoint) -> FloatArray | None:
        if not self.model_.wrong:
            return None
        self._origin = self._origin or place
        before, now = self._looked_ned_m, wgs84.ned_from_geo(place, self._origin)
        self._looked_ned_m = now
        return self._match.look(
            math.dist(before[:2], now[:2]), lasts_m(-now[2]), claim, self._rng, lambda: self._anywhere(request.prior)
        )

    def _anywhere(self, prior: PosePrior) -> FloatArray:
        (nn, _), (_, ee) = prior.cov_ne_m2
        return anywhere_m(3 * math.sqrt(max(nn, ee)), self._rng)

    def _motion(self, t_ns: int, place: GeoPoint) -> Odometry | None:
        """The way since the keyframe."""
        if not self.model_.odometry:
            return None
        self._origin = self._origin or place
        return self._odometry.look(t_ns, np.array(wgs84.ned_from_geo(place, self._origin)[:2]), self._rng)


def _gone_on(x: FloatArray, sigma: float, kept: float, rng: np.random.Generator) -> FloatArray:
    """(2,) a first-order Gauss-Markov process, one step later."""
    return kept * x + sigma * math.sqrt(1 - kept * kept) * rng.standard_normal(2)
