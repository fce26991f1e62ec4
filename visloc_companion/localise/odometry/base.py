"""What frame-to-frame odometry is given and what it answers. Positions are north, east, down (metres), angles radians."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import Reason
from visloc_companion.localise.mapped.ground import filled
from visloc_companion.types import FloatArray, Image, Odometry, Quat, Vec2


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """A frame and what the autopilot knew of the camera when it was taken.

    `q_ned_frd` is the attitude of the camera's body (top edge of the image forward, optical axis down); `sigma_tilt_rad` and
    `sigma_yaw_rad` are the 1-sigma of what is wrong with it for minutes. `up_m` is the altitude above any fixed zero; where a
    surface is given, above the zero of its heights, and `sigma_up_m` says how far off against that surface; `up_added_m` of it
    was added to the instrument's, which alone tells the climb from frame to frame. `place_ne_m` is where
    on the surface the camera is believed to be, `sigma_place_m` how far off on each axis. `height_m` is the height above what is
    straight below, needed where no surface is given: of a rangefinder (`ranged`, which sees trees and roofs), or altitude less
    elevation; `sigma_height_m` is what stays wrong with it. What a rangefinder met lies at `beam_ne_m` from the camera.
    """

    pixels: Image
    t_ns: int
    q_ned_frd: Quat
    sigma_tilt_rad: float
    sigma_yaw_rad: float
    up_m: float
    sigma_up_m: float = math.inf
    place_ne_m: Vec2 = (0.0, 0.0)
    sigma_place_m: float = 0.0
    height_m: float = math.nan
    sigma_height_m: float = math.inf
    ranged: bool = False
    beam_ne_m: Vec2 = (0.0, 0.0)
    up_added_m: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A window of the map's surface model: `up_m` (H, W) float32, NaN where unknown, and `A_ne_pix` (2, 3) from its pixels to
    metres north and east about the origin of `Sight.place_ne_m`; `dsm_gsd_m` as types.ReferencePatch."""

    up_m: NDArray[np.float32]
    A_ne_pix: FloatArray
    dsm_gsd_m: float = 0.0

    @property
    def pixel_m(self) -> float:
        """Side of a pixel on the ground."""
        return math.sqrt(abs(float(np.linalg.det(self.A_ne_pix[:, :2]))))

    @property
    def filled_up_m(self) -> NDArray[np.float32]:
        """(H, W) heights, the median of those known where there are none."""
        return filled(self.up_m, np.isfinite(self.up_m))


@dataclass(frozen=True, slots=True)
class FlowSettings:
    """Limits, and what is known of errors (1-sigma).

    Frames of more than `working_px` pixels are reduced; pixels below are those of the frames as worked on.
    `min_height_m`, `max_height_m`, `max_tilt_rad`: beyond, nothing is tried. `corner_spacing_px`: one corner in each cell of so
    many pixels. `min_corners` of a keyframe, `min_tracks` that fit of a frame, `min_inlier_share` of what was followed.
    `keep_overlap`: below, the next frame starts from a new keyframe; below `min_overlap` nothing is tried. `patience_ns`: for how
    long a keyframe is kept when frames fail. `max_sigma_share`: largest 1-sigma of an answer, as a share of the height.
    `max_scatter_px`: of tracks about the motion. `max_unlike`: grey levels (of evened pictures) by which what was found may
    differ from the keyframe, and `unlike_by_base` more for a base as long as the height (woods look otherwise from elsewhere);
    beyond is water, and then a keyframe must be as old as `doubt_ns` to be believed again. `max_blur_px`:
    where tracks fail, a larger smear (1-sigma) is given as the reason.
    `sigma_turn_rad`: of the autopilot's attitude from one frame to another of the same leg, each axis; `sigma_climb_m`: of its
    change of altitude. `relief_m`: how far what stands on the ground departs from a plane, and `slope_rad` that plane's slope,
    where no surface is given; `surface_m` and `surface_slope_rad`: the same of a given surface against the truth, and
    `surface_share` of its roughness is what all points in view may be off by together. `range_m`: of one point that a rangefinder
    measured.
    """

    working_px: int = 1_200_000
    min_height_m: float = 15.0
    max_height_m: float = 1500.0
    max_tilt_rad: float = math.radians(50.0)
    corner_spacing_px: int = 32
    min_corners: int = 40
    min_tracks: int = 25
    min_inlier_share: float = 0.5
    keep_overlap: float = 0.6
    min_overlap: float = 0.25
    patience_ns: int = 1_000_000_000
    max_sigma_share: float = 0.03
    max_scatter_px: float = 0.8
    max_unlike: float = 6.5
    unlike_by_base: float = 15.0
    doubt_ns: int = 700_000_000
    max_blur_px: float = 4.5
    sigma_turn_rad: float = math.radians(0.2)
    sigma_climb_m: float = 0.3
    relief_m: float = 3.0
    slope_rad: float = math.radians(2.5)
    surface_m: float = 0.7
    surface_slope_rad: float = math.radians(0.3)
    surface_share: float = 0.3
    range_m: float = 1.75


@dataclass(frozen=True, slots=True)
class Step:
    """The camera moved: `odometry` from the keyframe (`t_from_ns`) to this frame.

    `sigma_down_m` is that of the displacement's down component. With `closes` this frame is the keyframe of what follows: the
    leg is finished, the next one begins at its end.
    """

    odometry: Odometry
    sigma_down_m: float
    closes: bool
    evidence: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, slots=True)
class Blind:
    """This frame gives no motion, and why. `anchored`: it is a keyframe all the same, from which the next ones may move."""

    t_ns: int
    reason: Reason
    detail: str
    anchored: bool = False
    evidence: tuple[tuple[str, float], ...] = ()
