"""Corners of one frame found again in another, and how the camera turned between them.

Corners of a reduced picture are followed by Lucas-Kanade there and back in the other one, which is first turned back by what is
thought (a start, not a prior), and moved on as the ground is thought to have moved. Both are evened out, for Lucas-Kanade takes
the same ground for equally bright and a camera sets its exposure anew in each frame. The turn is solved in turn_solve.py.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.geo.camera import R_FRD_CAM, pinhole_matrix, scaled, unproject
from visloc_companion.geo.se3 import quat_from_R
from visloc_companion.localise.masked import ground_of
from visloc_companion.localise.odometry.turn_solve import Turned, solved
from visloc_companion.localise.structure.contrast import as_bytes, evened
from visloc_companion.localise.structure.tracks import corners_of
from visloc_companion.types import CameraModel, FloatArray, Image, Turn

WIDTH_PX = 320
"""Pictures are reduced to about this width: a turn needs no more, and it is over in two milliseconds."""
SPACING_PX, BORDER_PX, WINDOW_PX, LEVELS = 28, 8, 15, 3
STOP = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 10, 0.03)
RETURN_PX = 0.3
LEAST_TRACKS, LEAST_FOUND, LEAST_FITTING = 20, 0.3, 0.6
MOST_SCATTER_PX = 1.0
STILL_PX, MOVED_PX, LEAST_STILL, MOST_STILL = 1.0, 2.5, 0.05, 0.9
"""Tracks that stand still beside others that move, and shares of all at which they are told from these."""
MOST_TILT_COS = math.cos(math.radians(60.0))
HeightsAbove = Callable[[FloatArray], FloatArray]
"""(N,) by how much the camera is higher than what rays (N, 3), north, east, down, meet; NaN where that is not known."""


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A frame: reduced grey, evened out, its corners (N, 2) and their rays (N, 3), and what came with it; `nearer` (N,): how much
    higher the camera is than it is above what each corner shows, as a factor."""

    t_ns: int
    grey: Image
    corners: FloatArray
    rays: FloatArray
    R_ned_cam: FloatArray
    nearer: FloatArray


class Follower:
    """Frames of one camera, and what is between two of them. Keeps nothing."""

    def __init__(self, model: CameraModel) -> None:
        self._full = model
        self._model = scaled(model, min(1.0, WIDTH_PX / model.width_px))
        m = self._model
        self._K = pinhole_matrix(m)
        self._inner = np.zeros((m.height_px, m.width_px), np.bool_)
        self._inner[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = True
        if m.mask is not None:
            self._inner &= cv2.erode(ground_of(m), np.ones((2 * BORDER_PX + 1,) * 2, np.uint8)) > 0

    def seen(self, pixels: Image, t_ns: int, R_ned_cam: FloatArray, heights: HeightsAbove | None = None) -> Seen | None:
        """The frame, made ready; None where it is not this camera's. `heights`: of the camera above what rays meet."""
        if pixels.shape[:2] != (self._full.height_px, self._full.width_px) or pixels.dtype != np.uint8:
            return None
        size = (self._model.width_px, self._model.height_px)
        one = pixels if pixels.ndim == 2 else pixels[:, :, 1]
        small = one if one.shape == size[::-1] else cv2.resize(one, size, interpolation=cv2.INTER_AREA)
        grey = as_bytes(evened(np.asarray(cv2.GaussianBlur(small, (3, 3), 0), dtype=np.uint8)))
        corners = corners_of(grey, self._inner, SPACING_PX)
        rays, nearer = unproject(self._model, corners), np.ones(len(corners))
        if heights is not None and len(corners):
            nearer = _nearer(heights(rays @ R_ned_cam.T))
        return Seen(t_ns, grey, corners, rays, R_ned_cam, nearer)

    def between(self, a: Seen, b: Seen, R_ba: FloatArray, moved_ned: FloatArray) -> Turned | None:
        """The turn from `a` to `b`, from the start `R_ba` and `moved_ned` (3,), the displacement over the height; None where too
        little is found again, or does not fit."""
        if min(a.R_ned_cam[2, 2], b.R_ned_cam[2, 2]) < MOST_TILT_COS or np.array_equal(a.grey, b.grey):
            return None
        if len(a.corners) < LEAST_TRACKS:
            return None
        start = a.rays - (a.nearer * (a.rays @ a.R_ned_cam[2]))[:, None] * (a.R_ned_cam.T @ moved_ned)
        kept, found = self._followed(a, b, R_ba, start)
        grounded = of_ground(found - a.corners[kept])
        kept[kept], found = grounded, found[grounded]
        if kept.sum() < max(LEAST_TRACKS, LEAST_FOUND * len(kept)):
            return None
        turned = solved(a.rays[kept], unproject(self._model, found)[:, :2], R_ba, a.R_ned_cam, self._model.fx_px, a.nearer[kept])
        if turned is None or turned.fitting < LEAST_FITTING or turned.scatter_px > MOST_SCATTER_PX:
            return None
        return turned

    def _followed(self, a: Seen, b: Seen, R_ba: FloatArray, start: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Which corners of `a` (N,) come back, and where those are in `b` (M, 2); `start` (N, 3) are rays in `a`'s axes."""
        H = self._K @ R_ba @ np.linalg.inv(self._K)
        size = (self._model.width_px, self._model.height_px)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        drawn = np.asarray(cv2.warpPerspective(b.grey, H, size, flags=flags, borderMode=cv2.BORDER_REPLICATE), dtype=np.uint8)
        here = np.ascontiguousarray(a.corners[:, None], dtype=np.float32)
        ahead = start @ self._K.T
        begin = np.ascontiguousarray((ahead[:, :2] / ahead[:, 2:])[:, None], dtype=np.float32)
        options = {"winSize": (WINDOW_PX, WINDOW_PX), "criteria": STOP, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
        there, forth, _ = cv2.calcOpticalFlowPyrLK(a.grey, drawn, here, begin, maxLevel=LEVELS, **options)  # type: ignore[call-overload]
        again, back, _ = cv2.calcOpticalFlowPyrLK(drawn, a.grey, there, here.copy(), maxLevel=0, **options)  # type: ignore[call-overload]
        p = np.column_stack([there[:, 0], np.ones(len(there))]) @ H.T
        found = p[:, :2] / p[:, 2:3]
        inside = ((found >= BORDER_PX) & (found < np.array(size) - BORDER_PX)).all(1)
        column, row = found[inside].astype(np.intp).T
        inside[inside] = self._inner[row, column]
        kept = inside & (forth.ravel() > 0) & (back.ravel() > 0) & (np.hypot(*(again - here)[:, 0].T) < RETURN_PX)
        return kept, np.asarray(found[kept], dtype=np.float64)


def of_ground(shifts_px: FloatArray) -> NDArray[np.bool_]:
    """(N,) which tracks may be of the ground, from their shifts (N, 2): where most of those that moved moved far, what stands
    still is a text in the picture, dirt on the lens or the vehicle's own gear. All where all stand still, or move little."""
    length = np.hypot(shifts_px[:, 0], shifts_px[:, 1])
    still = length < STILL_PX
    apart = LEAST_STILL <= float(still.mean()) <= MOST_STILL if len(still) else False
    return ~still if apart and float(np.median(length[~still])) > MOVED_PX else np.ones(len(still), np.bool_)


def _nearer(heights_m: FloatArray) -> FloatArray:
    """(N,) the median of heights above what corners show over each of them; 1 where that is not known."""
    known = np.isfinite(heights_m) & (heights_m > 0)
    if not known.any():
        return np.ones(len(heights_m))
    return np.where(known, float(np.median(heights_m[known])) / np.where(known, heights_m, 1.0), 1.0)


def turn_of(a: Seen, b: Seen, turned: Turned) -> Turn:
    """The turn of the camera's body."""
    R = R_FRD_CAM @ turned.R_ba.T @ R_FRD_CAM.T
    cov = R_FRD_CAM @ turned.covariance @ R_FRD_CAM.T
    rows = [(float(row[0]), float(row[1]), float(row[2])) for row in (cov + cov.T) / 2]
    return Turn(a.t_ns, b.t_ns, quat_from_R(R), (rows[0], rows[1], rows[2]))
