"""Refuses a picture that stands still while the camera moved: an encoder that lost its camera goes on with the last picture, and
compresses it anew, so that no two are equal in every pixel.

Such a picture is localised well, at a place that the vehicle has long left, and odometry between two of them shows a vehicle that
stands: both agree that GNSS is false. Two pictures are held for one where their difference is less than a small shift would
make; how far the camera should have moved by then, its attitude says, and the place that is believed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from visloc_companion.errors import MapError, Reason
from visloc_companion.geo.camera import R_FRD_CAM, project, unproject
from visloc_companion.geo.se3 import R_from_quat
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.localise.answer import refused
from visloc_companion.localise.asking import Asking
from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.features.gradient import grey
from visloc_companion.localise.frame import unfit
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.types import CameraModel, Fix, FloatArray, Image, LocaliseRequest, NoFix, PosePrior

WIDTH_PX = 160
"""Pictures are compared at this width: compression and noise average away, a shift of a pixel of the frame does not."""
EVEN_PX = 15
"""What is smoother than this is the lens's shade and the light's, not the ground."""
BLOCK_PX, FEWEST_BLOCKS, SHARE = 20, 6, 0.6
"""Pictures are compared block by block; of those that show something so many show the same."""
LEAST_SLOPE = 0.4
"""Grey levels a pixel (rms), in every direction: with less there is nothing whose shift could be seen."""
STILL_PX = 0.15
"""What is found between two pictures of one view, pixels at WIDTH_PX."""
SMOOTH_PX = 1.0
NOISE = 2.0
"""Mean square of what no shift explains, as a share of that of the weaker gradient: then noise, smoothed by SMOOTH_PX, makes up
less than half of the gradient, and a shift comes out at half its size at least."""
MOVED_PX = 1.0
"""A camera that moved by so much does not show the same picture: 0.4 degrees with a lens of 60 degrees."""
STEP_NS, STEP_PX, STEPS, WAY_PX = 250_000_000, 0.25, 3, 2.0
"""A way of so many steps is believed, where a leap of the place alone, from one step to the next, is not for longer than one."""
STRETCH_NS = 10_000_000_000
"""Attitudes so far apart differ by their drift, too."""
LEAST_HEIGHT_M = 10.0
"""Lower the vehicle may stand, and what a receiver's wander makes it believe it moved is many pixels."""


@dataclass(frozen=True, slots=True, eq=False)
class _Stretch:
    """Pictures that show the same: how the first one looked, and from where. The last `steps` steps of the way, the newest of
    which ended at `at`, each went on, from `start`."""

    first: Float32Array
    prior: PosePrior
    since_ns: int
    start: PosePrior
    at: PosePrior
    at_ns: int
    steps: int = 0
    frozen: bool = False


class MovingFramesOnly(Asking):
    """protocols.Localiser: asks another one, but not about a picture that stands still while the camera moved."""

    def __init__(self, localiser: Localiser, model: CameraModel) -> None:
        super().__init__(localiser)
        self._model = model
        self._points_px = _points_px(model)
        self._stretch: _Stretch | None = None
        self._judged: tuple[int, bool] | None = None

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """As the localiser that is asked; FROZEN for a picture that stands still while the camera moved."""
        frame_id = request.frame.frame_id
        if self._judged is None or self._judged[0] != frame_id:
            self._judged = frame_id, unfit(pixels, self._model) is None and self._stands(request, pixels, ref)
        if not self._judged[1]:
            return self._localiser.localise(request, pixels, ref)
        why = "the picture stands still while the camera moves: the camera is frozen"
        return refused(request, self.method, Reason.FROZEN, why)

    def _stands(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> bool:
        seen, now_ns, prior = small(pixels), request.frame.t_ns, request.believed
        stretch, begun = self._stretch, _Stretch(seen, prior, now_ns, prior, prior, now_ns)
        if stretch is None or not is_same(stretch.first, seen):
            self._stretch = begun
            return False
        height_m = _height_m(prior, ref)
        if height_m < LEAST_HEIGHT_M:
            return False
        if stretch.frozen:
            return True
        turned = self._moved_px(stretch.prior, prior, math.inf) >= MOVED_PX
        if not turned and now_ns - stretch.since_ns > STRETCH_NS:
            self._stretch = begun
            return False
        moved_px = self._moved_px(stretch.at, prior, height_m)
        if now_ns - stretch.at_ns >= STEP_NS:
            steps, start = (stretch.steps + 1, stretch.start) if moved_px >= STEP_PX else (0, prior)
            stretch = replace(stretch, start=start, at=prior, at_ns=now_ns, steps=steps)
        flew = stretch.steps >= STEPS and self._moved_px(stretch.start, prior, height_m) >= WAY_PX
        self._stretch = replace(stretch, frozen=turned or flew)
        return turned or flew or moved_px >= MOVED_PX

    def _moved_px(self, before: PosePrior, now: PosePrior, height_m: float) -> float:
        """By how many pixels (at WIDTH_PX) ground so far below should have moved, in the median over the picture; infinitely far
        below only turns move it."""
        d_over_height = np.array(ned_from_geo(now.place, before.place)) / height_m
        return moved_px(self._model, self._points_px, before, now, d_over_height) * WIDTH_PX / self._model.width_px


def is_same(first: Float32Array, seen: Float32Array) -> bool:
    """Whether two pictures as `small` makes them (H, W) differ by noise and shifts below STILL_PX.

    Least squares in each block on the difference with the mean gradient (Lucas and Kanade 1981). A block is judged where it has a
    slope in every direction: rows of a field that is flown along show the same for long. What does not move with the ground
    (landing gear, the rim of a fisheye, a text) leaves most blocks to the ground.
    """
    if first.shape != seen.shape:
        return False
    d = (seen - first).astype(np.float64)
    g_v, g_u = np.gradient(((seen + first) / 2).astype(np.float64))
    uu, uv, vv, ud, vd, dd = (
        _means(np.asarray(a * b)) for a, b in ((g_u, g_u), (g_u, g_v), (g_v, g_v), (g_u, d), (g_v, d), (d, d))
    )
    least2 = (uu + vv) / 2 - np.hypot((uu - vv) / 2, uv)
    shown = least2 >= LEAST_SLOPE**2
    det = np.where(shown, uu * vv - uv * uv, 1.0)
    shift_u, shift_v = (uv * vd - vv * ud) / det, (uv * ud - uu * vd) / det
    rest2 = dd + shift_u * ud + shift_v * vd
    still = shown & (rest2 <= NOISE * least2) & (np.hypot(shift_u, shift_v) <= STILL_PX)
    return int(shown.sum()) >= FEWEST_BLOCKS and int(still.sum()) >= SHARE * int(shown.sum())


def _means(product: FloatArray) -> FloatArray:
    """Means over whole blocks of BLOCK_PX."""
    rows, cols = (n // BLOCK_PX for n in product.shape)
    whole = product[: rows * BLOCK_PX, : cols * BLOCK_PX].reshape(rows, BLOCK_PX, cols, BLOCK_PX)
    return np.asarray(whole.mean(axis=(1, 3)))


def moved_px(model: CameraModel, points_px: FloatArray, before: PosePrior, now: PosePrior, d_over_height: FloatArray) -> float:
    """Median shift (pixels) of ground that was seen at `points_px` (N, 2). `d_over_height` (3,) is the camera's way since then,
    north, east, down, in heights above the ground. NaN where none of it is seen."""
    rays = unproject(model, points_px) @ (R_from_quat(before.q_ned_frd) @ R_FRD_CAM).T
    below = rays[:, 2] > 0
    if not below.any():
        return math.nan
    ground = rays[below] / rays[below, 2:] - d_over_height
    again_px = project(model, ground @ (R_from_quat(now.q_ned_frd) @ R_FRD_CAM))
    shifts = np.linalg.norm(again_px - points_px[below], axis=1)
    return float(np.nanmedian(shifts)) if np.isfinite(shifts).any() else math.nan


def small(pixels: Image) -> Float32Array:
    """Grey, WIDTH_PX wide, without noise of single pixels and without what changes slowly over the picture."""
    height_px, width_px = pixels.shape[:2]
    size = WIDTH_PX, max(1, round(height_px * WIDTH_PX / width_px))
    reduced = cv2.resize(grey(pixels), size, interpolation=cv2.INTER_AREA)
    smooth = cv2.GaussianBlur(reduced, (0, 0), SMOOTH_PX)
    return np.asarray(smooth - cv2.blur(smooth, (EVEN_PX, EVEN_PX)), np.float32)


def _height_m(prior: PosePrior, ref: ReferenceMap) -> float:
    """Above the ground, or above height zero of a map without heights and beside the map."""
    try:
        ground_m = ref.height_amsl_m(*ref.to_map(prior.place.lat_deg, prior.place.lon_deg))
    except MapError:
        ground_m = math.nan
    return prior.place.h_amsl_m - (ground_m if math.isfinite(ground_m) else 0.0)


def _points_px(model: CameraModel) -> FloatArray:
    u, v = np.meshgrid(*(np.array([0.25, 0.5, 0.75]) * size for size in (model.width_px, model.height_px)))
    return np.column_stack([u.ravel(), v.ravel()])
