"""What motion stereo is given and what it answers. Colour is discarded: a cloud is points in metres.

`local` is any level frame of east, north, up in metres about an origin of the caller's choice; `cam` is right, down, forward.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from visloc_companion.errors import Reason
from visloc_companion.types import FloatArray, Image


@dataclass(frozen=True, slots=True, eq=False)
class PosedFrame:
    """A frame and where the autopilot and the odometry believe that it was taken.

    `T_local_cam` (4, 4). `sigma_position_m` is the 1-sigma of each axis relative to the other frames (what all frames share does
    not bend or scale the cloud), `sigma_tilt_rad` and `sigma_yaw_rad` those of the attitude. `height_m` is the height above the
    surface straight below (rangefinder, or altitude less the map's surface); with an infinite `sigma_height_m` it serves the
    planning only, else the cloud's scale as well.
    """

    pixels: Image
    T_local_cam: FloatArray
    sigma_position_m: float
    sigma_tilt_rad: float
    sigma_yaw_rad: float
    height_m: float
    sigma_height_m: float = math.inf


@dataclass(frozen=True, slots=True)
class StereoSettings:
    """Limits of pairs, points and the cloud. Pixels are those of the frames as worked on.

    Pairs: `overlap` and `base_to_height` are preferred ranges; a pair below `min_overlap`, below the least or beyond
    `max_base_to_height` is not used. `max_partners` frames are matched with the one in their middle; up to `max_stars` of these
    go on from each other over what was overflown. `max_blur_px`: where too
    little is found, a smear of a larger 1-sigma is given as the reason. Frames of more than `working_px` pixels are reduced.
    Tracks: spacing of corners, their least number and measuring error. Matching: half-width of the window of the sub-pixel step,
    least correlation and half-width of its window, largest 1-sigma of a disparity. Cloud: side of the cells that keep one point
    of the upper surface (0: two pixels on the ground), least number of points, least share of the common ground that has points,
    largest median 1-sigma of the heights as a share of the height above ground.
    """

    overlap: tuple[float, float] = (0.5, 0.8)
    min_overlap: float = 0.4
    base_to_height: tuple[float, float] = (0.1, 0.4)
    max_base_to_height: float = 0.6
    max_partners: int = 2
    max_stars: int = 3
    max_blur_px: float = 4.5
    working_px: int = 400_000
    corner_spacing_px: int = 20
    min_tracks: int = 30
    sigma_track_px: float = 0.25
    window_half_px: int = 3
    min_correlation: float = 0.7
    correlation_half_px: int = 5
    max_sigma_px: float = 0.7
    cell_m: float = 0.0
    min_points: int = 500
    min_completeness: float = 0.2
    max_sigma_share: float = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class LocalCloud:
    """The upper surface as points, and the frames' poses that belong to it.

    `points_m` (N, 3) in `local`; `sigma_m` (N,) 1-sigma of each height by disparity alone; `pix` (N, 2) where the reference frame
    shows the point (pixels as delivered, with the lens's distortion). `frames` are the numbers of the frames used, `T_local_cam`
    (F, 4, 4) their refined poses, `reference` the number of the latest of them. What all points share: `sigma_scale` (relative),
    `sigma_tilt_rad` and `sigma_yaw_rad` about the cloud's middle, which registration has to find. `scale_per_height`: by how much
    (relative) the cloud is too large for each metre that the frames' heights are too great by, part of `sigma_scale`.
    """

    points_m: FloatArray
    sigma_m: FloatArray
    pix: FloatArray
    frames: tuple[int, ...]
    T_local_cam: FloatArray
    reference: int
    sigma_scale: float
    sigma_tilt_rad: float
    sigma_yaw_rad: float
    evidence: tuple[tuple[str, float], ...]
    scale_per_height: float = 0.0

    def pose_of(self, frame: int) -> FloatArray:
        """(4, 4) T_local_cam of a frame by its number. Raises ValueError for a frame that was not used."""
        if frame not in self.frames:
            raise ValueError(f"frame {frame} is not among those used: {self.frames}")
        return np.asarray(self.T_local_cam[self.frames.index(frame)], dtype=np.float64)


@dataclass(frozen=True, slots=True)
class NoCloud:
    """No cloud can be had from these frames, and why."""

    reason: Reason
    detail: str
    evidence: tuple[tuple[str, float], ...] = ()
