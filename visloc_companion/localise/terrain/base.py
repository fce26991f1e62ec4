"""What terrain navigation is asked and what it answers. Axes: metres north and east of one origin, heights above sea level."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import Reason
from visloc_companion.types import Cov2, FloatArray, Vec2


class Kind(StrEnum):
    """What the soundings are: an area swept by stereo or a scanner, or a line under the track."""

    PATCH = "patch"
    PROFILE = "profile"


@dataclass(frozen=True, slots=True, eq=False)
class Soundings:
    """Surface points of one stretch of flight, by dead reckoning relative to where the vehicle was at `t_ns`.

    `points_m` (N, 3) north, east, up of the vehicle at `t_ns`; `age_s` (N,) seconds before `t_ns` at which each was measured;
    `sigma_m` 1-sigma of a measured height; `beam_m` (N, 3) the same points north, east, up of the vehicle when it measured them,
    about which errors of heading and tilt turn them (None: of the vehicle at `t_ns`, as of one shot). Raises ValueError for other
    shapes or values that are not finite.
    """

    t_ns: int
    points_m: FloatArray
    age_s: FloatArray
    sigma_m: float
    kind: Kind = Kind.PATCH
    beam_m: FloatArray | None = None

    def __post_init__(self) -> None:
        if self.points_m.ndim != 2 or self.points_m.shape[1] != 3 or self.age_s.shape != (len(self.points_m),):
            raise ValueError(f"soundings are (N, 3) with ages (N,), got {self.points_m.shape} and {self.age_s.shape}")
        if self.beam_m is not None and self.beam_m.shape != self.points_m.shape:
            raise ValueError(f"beams are (N, 3) as the soundings, got {self.beam_m.shape} for {self.points_m.shape}")
        if not (np.isfinite(self.points_m).all() and np.isfinite(self.age_s).all()):
            raise ValueError("soundings hold values that are not finite: leave out what the sensor did not measure")
        if not self.sigma_m > 0:
            raise ValueError(f"the soundings' sigma is {self.sigma_m} m: give a positive one")

    @property
    def beams_m(self) -> FloatArray:
        """(N, 3) points from the vehicle when it measured them."""
        return self.points_m if self.beam_m is None else self.beam_m

    def picked(self, which: NDArray[np.int64]) -> Soundings:
        """The soundings of (M,) indices."""
        beam = None if self.beam_m is None else self.beam_m[which]
        return replace(self, points_m=self.points_m[which], age_s=self.age_s[which], beam_m=beam)


@dataclass(frozen=True, slots=True)
class TerrainPrior:
    """Where the vehicle believes to be at the soundings' `t_ns`, and how far its dead reckoning is to be believed (1-sigma).

    `h_amsl_m` is the navigation height (barometer), `sigma_tilt_rad` of roll and pitch each; over the stretch and per axis,
    `sigma_drift_mps` and `sigma_drift_mps2` are of the error of velocity and acceleration, `sigma_wander_m` of what remains
    of the track's error beside these. `sigma_h_walk` (m/sqrt(s)): the navigation height's error is a random walk of this.
    """

    p_ne_m: Vec2
    cov_ne_m2: Cov2
    h_amsl_m: float
    sigma_h_m: float
    sigma_yaw_rad: float = 0.005
    sigma_tilt_rad: float = 0.001
    sigma_drift_mps: float = 0.1
    sigma_drift_mps2: float = 0.0
    sigma_wander_m: float = 0.0
    sigma_h_walk: float = 0.1

    def __post_init__(self) -> None:
        numbers = (*self.p_ne_m, *self.cov_ne_m2[0], *self.cov_ne_m2[1], self.h_amsl_m, self.sigma_h_m)
        if not np.isfinite(numbers).all() or np.linalg.eigvalsh(np.array(self.cov_ne_m2))[0] <= 0 or self.sigma_h_m <= 0:
            raise ValueError(f"the prior {self} is not finite with a positive definite covariance")


@dataclass(frozen=True, slots=True)
class TerrainFix:
    """Position of the vehicle at `t_ns` from the terrain alone: the prior chose where to look and is not part of the covariance.

    What the soundings tell is by how much the navigation height was off in their mean, `height_age_s` before `t_ns`, with
    `sigma_h_then_m`; `h_amsl_m` carries that on to `t_ns`, and `sigma_h_m` has what the navigation height walked since.
    `probability_wrong` is the calibrated probability that the place is another one: off by more than `verify.RIGHT_M` and than
    the covariance explains. `by_drift` (2, 4): by how much the position is off, north and east, for each unit by which the dead
    reckoning's velocity (m/s) and acceleration (m/s²) are too large at `t_ns`, north and east each: what the ground does not tell
    of the prior's drift. That is in the covariance, and whoever estimates the drift has it in its own.
    """

    t_ns: int
    p_ne_m: Vec2
    cov_ne_m2: Cov2
    h_amsl_m: float
    sigma_h_m: float
    probability_wrong: float
    height_age_s: float
    sigma_h_then_m: float
    by_drift: tuple[tuple[float, ...], tuple[float, ...]]
    evidence: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, slots=True)
class NoTerrainFix:
    """The terrain gives no position, and why: LOW_TEXTURE is flat ground or water, OUTSIDE_MAP no elevations about the prior."""

    t_ns: int
    reason: Reason
    detail: str
    evidence: tuple[tuple[str, float], ...] = ()
