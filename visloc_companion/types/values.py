"""Values that localisers, maps and the filter exchange."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import Reason
from visloc_companion.types.basic import Cov2, FloatArray, Image, Vec3, Verdict
from visloc_companion.types.mask import CameraMask

DistortionModel = Literal["brown_conrady", "rational", "fisheye"]
DISTORTION_COEFFICIENTS: dict[DistortionModel, tuple[str, ...]] = {
    "brown_conrady": ("k1", "k2", "p1", "p2", "k3"),
    "rational": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}
"""In the order in which OpenCV writes them. ROS calls the models plumb_bob, rational_polynomial and equidistant."""


@dataclass(frozen=True, slots=True)
class CameraModel:
    """A calibrated camera, in pixels of `pix`. Distortion coefficients in OpenCV's order: `brown_conrady` k1 k2 p1 p2 k3,
    `rational` k1 k2 p1 p2 k3 k4 k5 k6, `fisheye` (equidistant) k1 k2 k3 k4. `mask`: where it sees ground; None is all over.
    Raises ValueError for another number of coefficients, and for a mask of another size."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    distortion_model: DistortionModel = "brown_conrady"
    mask: CameraMask | None = None

    def __post_init__(self) -> None:
        names = DISTORTION_COEFFICIENTS[self.distortion_model]
        if len(self.distortion) != len(names):
            raise ValueError(f"{self.distortion_model} has {len(names)} coefficients, not {len(self.distortion)}")
        mask, size_px = self.mask, (self.width_px, self.height_px)
        if mask is not None and (mask.width_px, mask.height_px) != size_px:
            raise ValueError(f"a mask of {mask.width_px} x {mask.height_px} pixels, frames have {size_px[0]} x {size_px[1]}")


@dataclass(frozen=True, slots=True, eq=False)
class ReferencePatch:
    """A window of the reference map, immutable: pixels, validity, heights and where it lies.

    `T_map_pix` (2, 3) maps homogeneous `pix` coordinates (u, v, 1) (centre of the top-left pixel = 0, 0) to easting and
    northing in the map's CRS. `dsm_amsl_m` is the surface height per pixel in metres above sea level; `dsm_gsd_m`: how far apart
    on the ground the surface model's own samples are, metres, 0 for a plane or where that is not known.
    """

    pixels: Image
    valid: NDArray[np.bool_]
    dsm_amsl_m: NDArray[np.float32]
    T_map_pix: FloatArray
    gsd_m: float
    heading_rad: float
    dsm_gsd_m: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class FeaturePatch:
    """A window of a map's stored features, heading 0: (H, W, C) float32, zero where not valid; the rest as `ReferencePatch`."""

    features: NDArray[np.float32]
    valid: NDArray[np.bool_]
    dsm_amsl_m: NDArray[np.float32]
    T_map_pix: FloatArray
    gsd_m: float
    dsm_gsd_m: float = 0.0


@dataclass(frozen=True, slots=True)
class NavState:
    """The filter's state at `t_ns`: position and velocity in NED at the EKF origin, covariances, and what they rest on.

    `cov_v_ne_m2ps2` is that of the horizontal velocity, None where unknown.
    """

    t_ns: int
    p_ned_m: Vec3
    v_ned_mps: Vec3
    cov_ne_m2: Cov2
    sigma_d_m: float
    age_of_fix_s: float
    cov_v_ne_m2ps2: Cov2 | None = None


@dataclass(frozen=True, slots=True)
class Accepted:
    """The filter took the measurement; `nis` is its normalised innovation squared (2 degrees of freedom)."""

    nis: float


@dataclass(frozen=True, slots=True)
class Rejected:
    """The filter refused the measurement."""

    reason: Reason
    nis: float


@dataclass(frozen=True, slots=True)
class TooOld:
    """The measurement is older than the filter's memory."""

    age_s: float


@dataclass(frozen=True, slots=True)
class GnssVerdict:
    """The monitor's verdict with its evidence: each item is (name, value, threshold).

    `probability_false` is the posterior probability that the position which the receiver reports is false (core/gnss.py).
    """

    verdict: Verdict
    since_ns: int
    reasons: tuple[str, ...]
    evidence: tuple[tuple[str, float, float], ...]
    probability_false: float = 0.0
