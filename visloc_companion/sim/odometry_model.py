"""Odometry of flights without pictures: it errs on its own, in scale and in heading, as it claims; the latter two last."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from visloc_companion.types import FloatArray, Odometry

KEYFRAME_S = 2.0
LEG_SIGMA_M, SCALE_SIGMA, HEADING_SIGMA_RAD = 0.1, 0.01, math.radians(1.0)
_SALT = 5


@dataclass(slots=True)
class OdometryModel:
    """The odometry of one flight: a displacement from the keyframe, which is moved on every KEYFRAME_S."""

    scale: float
    heading_rad: float
    _keyframe: tuple[int, FloatArray] | None = field(default=None, init=False)

    @staticmethod
    def drawn(rng: np.random.Generator) -> OdometryModel:
        """One with errors that are as large as it claims."""
        scale, heading = rng.standard_normal(2) * (SCALE_SIGMA, HEADING_SIGMA_RAD)
        return OdometryModel(float(scale), float(heading))

    def lose(self) -> None:
        """The next frame begins anew."""
        self._keyframe = None

    def look(self, t_ns: int, p_ne_m: FloatArray, rng: np.random.Generator) -> Odometry | None:
        """What is seen from a place (2,) at a time; None of the first frame."""
        if self._keyframe is None:
            self._keyframe = (t_ns, p_ne_m)
            return None
        from_ns, start = self._keyframe
        if t_ns <= from_ns:
            return None
        d = p_ne_m - start
        seen = (1 + self.scale) * d + self.heading_rad * np.array([-d[1], d[0]]) + LEG_SIGMA_M * rng.standard_normal(2)
        var = LEG_SIGMA_M**2 + (SCALE_SIGMA * d) ** 2 + (HEADING_SIGMA_RAD * d[::-1]) ** 2
        if t_ns - from_ns >= KEYFRAME_S * 1e9:
            self._keyframe = (t_ns, p_ne_m)
        moved, cov = (float(seen[0]), float(seen[1]), 0.0), ((float(var[0]), 0.0), (0.0, float(var[1])))
        return Odometry(t_ns, from_ns, t_ns, moved, cov, SCALE_SIGMA, HEADING_SIGMA_RAD)


def drawn_for(seed: int) -> tuple[OdometryModel, np.random.Generator]:
    """The odometry of a flight with this seed, and the random numbers of its looks."""
    rng = np.random.default_rng([seed, _SALT])
    return OdometryModel.drawn(rng), rng


def stretched(seen: Odometry, share: float, sigma_share: float) -> Odometry:
    """A displacement that comes out longer by a share, because the height over the ground is wrong by it, and claims that."""
    north, east = ((1 + share) * d for d in seen.displacement_ned_m[:2])
    (nn, ne), (_, ee) = seen.cov_ne_m2
    var = sigma_share**2
    cov = ((nn + var * north * north, ne + var * north * east), (ne + var * north * east, ee + var * east * east))
    moved = (north, east, seen.displacement_ned_m[2])
    return replace(seen, displacement_ned_m=moved, cov_ne_m2=cov, sigma_scale=math.hypot(seen.sigma_scale, sigma_share))
