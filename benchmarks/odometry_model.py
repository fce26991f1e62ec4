"""Odometry of flights without pictures: it errs on its own, in scale and in heading, as it claims; the latter two last.

Fixes of such flights claim to be wrong with a probability between CLAIMS, whose logarithm is uniform.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from visloc_companion.types import FloatArray, Odometry

KEYFRAME_S = 2.0
LEG_SIGMA_M, SCALE_SIGMA, HEADING_SIGMA_RAD = 0.1, 0.01, math.radians(1.0)
CLAIMS = (1e-4, 0.05)
"""Least and greatest claim of an accepted fix."""


def claimed(rng: np.random.Generator) -> float:
    """The probability of being wrong that a fix claims."""
    return float(np.exp(rng.uniform(*np.log(CLAIMS))))


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
