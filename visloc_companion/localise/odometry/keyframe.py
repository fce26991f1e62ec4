"""The frame that the next ones are followed from: its corners, and where on the ground they lie."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import Reason
from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import R_from_quat
from visloc_companion.localise.odometry.base import FlowSettings, Sight, Surface
from visloc_companion.localise.odometry.below import Reading, descends, on_plane, on_surface, read_near
from visloc_companion.localise.odometry.picture import Picture
from visloc_companion.localise.odometry.solve import Ground
from visloc_companion.localise.structure.tracks import BORDER_PX, corners_of
from visloc_companion.types import FloatArray

RANGED_APART = 3.0
"""What a rangefinder meets on the way stands off the mean height of the corners, which like crowns and roofs, by so many reliefs:
fitted on training flights, as FlowSettings.range_m is."""


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """A frame with its corners (N, 2) and the ground below them, from a map's surface if `mapped`; `height_m` is that of the
    camera above them (median), `place_ne_m` (2,) where it was along the stretch."""

    sight: Sight
    picture: Picture
    R_ned_cam: FloatArray
    corners: FloatArray
    ground: Ground
    height_m: float
    mapped: bool
    place_ne_m: FloatArray

    def ground_of(self, number: NDArray[np.intp]) -> Ground:
        """The ground below some of the corners."""
        return self.ground.at(number)


def attitude(sight: Sight) -> FloatArray:
    """(3, 3) R_ned_cam."""
    return R_from_quat(sight.q_ned_frd) @ R_FRD_CAM


def keyframe_of(
    sight: Sight, picture: Picture, surface: Surface | None, place_ne_m: FloatArray, settings: FlowSettings
) -> Keyframe | tuple[Reason, str]:
    """The keyframe, or why this frame is none."""
    R = attitude(sight)
    corners = corners_of(picture.grey, picture.seen, settings.corner_spacing_px)
    rays = picture.rays(corners) @ R.T
    steep = descends(rays)
    corners, rays = corners[steep], rays[steep]
    if len(corners) < settings.min_corners:
        return Reason.LOW_TEXTURE, f"{len(corners)} corners, {settings.min_corners} are needed"
    ground = on_plane(rays, sight, settings) if surface is None else on_surface(rays, sight, surface, settings)
    if ground is None:
        return Reason.TOO_LOW, "the camera is not above the surface that was given"
    known = np.isfinite(ground.at_ned_m).all(1) & np.isfinite(ground.spread_m)
    if known.sum() < settings.min_corners:
        return Reason.OUTSIDE_MAP, f"{int(known.sum())} corners lie on the surface that was given"
    ground = ground.at(np.flatnonzero(known))
    height = float(np.median(ground.at_ned_m[:, 2]))
    return Keyframe(sight, picture, R, corners[known], ground, height, surface is not None, place_ne_m)


def with_readings(key: Keyframe, readings: Sequence[Reading], settings: FlowSettings) -> Keyframe:
    """The keyframe with what heights read near it say of the ground: its plane, and of a rangefinder the very points. Where one
    measured anything near, nothing else counts."""
    sight, plain = key.sight, ~key.ground.ranged
    middle_ne_m = np.median(key.ground.at_ned_m[plain, :2], axis=0)
    of_range = [reading for reading in readings if reading.sigma_range_m is not None] or [*readings] * sight.ranged
    at = read_near(of_range, key.place_ne_m, sight.up_m - sight.up_added_m, key.height_m, middle_ne_m)
    ranged = bool(len(at)) or sight.ranged
    sigmas_m = [sight.sigma_height_m if reading.sigma_range_m is None else reading.sigma_range_m for reading in of_range]
    sigma_range_m = max(sigmas_m, default=0.0) if ranged else 0.0
    if not ranged:
        others = [reading for reading in readings if reading.sigma_range_m is None]
        at = read_near(others, key.place_ne_m, sight.up_m, key.height_m, np.zeros(2))
    g = replace(key.ground_of(np.flatnonzero(plain)), sigma_range_m=sigma_range_m)
    if not key.mapped:
        below_plane = np.column_stack([at[:, :2], at[:, 2] - sight.height_m])
        sigma = settings.relief_m * (RANGED_APART if ranged else 1.0)
        g = replace(g, readings=below_plane, reading_m=sigma, readings_ranged=ranged)
    corners = key.corners[plain]
    if ranged and len(at):
        pix, seen = _pixels(key, at)
        at, pix = at[seen], pix[seen]
        measured = np.concatenate([np.zeros(len(corners), np.bool_), np.ones(len(at), np.bool_)])
        spread = np.concatenate([g.spread_m, np.full(len(at), settings.range_m)])
        g = replace(g, at_ned_m=np.vstack([g.at_ned_m, at]), spread_m=spread, ranged=measured)
        corners = np.vstack([corners, pix])
    return replace(key, corners=corners, ground=g)


def _pixels(key: Keyframe, at_ned_m: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """(M, 2) where the keyframe shows points, and which of them it does."""
    pix = seen_at(key.picture, key.R_ned_cam, at_ned_m)
    inside = (pix >= BORDER_PX).all(1) & (pix < np.array(key.picture.size) - BORDER_PX).all(1)
    return pix, np.asarray(inside, dtype=np.bool_)


def seen_at(picture: Picture, R_ned_cam: FloatArray, at_ned_m: FloatArray) -> FloatArray:
    """(N, 2) pixels where a camera shows points (N, 3) given from it; far outside for what lies behind."""
    q = at_ned_m @ R_ned_cam
    z = np.where(q[:, 2] > 1e-3, q[:, 2], np.nan)
    pix = q[:, :2] / z[:, None] * np.array([picture.K[0, 0], picture.K[1, 1]]) + picture.K[:2, 2]
    return np.asarray(np.nan_to_num(pix, nan=-1e6), dtype=np.float64)
