"""Frames of a rolling shutter as if all their rows had been exposed with the middle one.

While the camera turns and moves, each row sees the ground from another pose. With the body rates, the velocity and the height
above ground that a request states, a pixel of the middle's picture is found in the row that saw it, over level ground (Liang,
Chang and Chen, "Analysis and compensation of rolling shutter effect", 2008, with the motion from the autopilot).
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from visloc_companion.geo.camera import R_FRD_CAM, project, unproject
from visloc_companion.geo.se3 import R_from_quat
from visloc_companion.localise.asking import Asking
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.types import CameraModel, Fix, FloatArray, Image, LocaliseRequest, NoFix, Quat, Readout

GRID_PX = 16
"""The shift is smooth: it is computed about so many pixels apart."""
LEAST_PX = 0.1
MIN_DESCENT = 0.1
"""A ray that descends by less, of unit length, sees ground so far off that only turns move it."""
PASSES = 3


class Unrolled(Asking):
    """protocols.Localiser: asks another one about frames that are set right where their request says how the shutter rolled."""

    def __init__(self, localiser: Localiser, model: CameraModel) -> None:
        super().__init__(localiser)
        self._model = model

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The other localiser's answer."""
        if request.readout is None:
            return self._localiser.localise(request, pixels, ref)
        if pixels.dtype == np.uint8 and pixels.shape[:2] == (self._model.height_px, self._model.width_px):
            pixels = unrolled(pixels, self._model, request.prior.q_ned_frd, request.readout)
        return self._localiser.localise(replace(request, readout=None), pixels, ref)


def unrolled(pixels: Image, model: CameraModel, q_ned_frd: Quat, readout: Readout) -> Image:
    """The picture (H, W[, 3]) with all rows as of the middle one; `q_ned_frd` is the attitude of the camera's body then.

    What no row saw is repeated from the nearest pixel that one did.
    """
    size_px = model.width_px, model.height_px
    n_across, n_down = (2 + size // GRID_PX for size in size_px)
    across, down = np.linspace(0, size_px[0] - 1, n_across), np.linspace(0, size_px[1] - 1, n_down)
    grid = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    seen = _where_seen(grid, model, q_ned_frd, readout)
    moved = np.where(np.isfinite(seen).all(1, keepdims=True), seen - grid, 0.0)  # a fisheye looks past its own plane at the rim
    if float(np.abs(moved).max()) < LEAST_PX:
        return pixels
    shift = moved.reshape(n_down, n_across, 2).astype(np.float32)
    to_grid = np.array([[1 / across[1], 0.0, 0.0], [0.0, 1 / down[1], 0.0]])
    at = cv2.warpAffine(shift, to_grid, size_px, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE)
    u = at[..., 0] + np.arange(size_px[0], dtype=np.float32)
    v = at[..., 1] + np.arange(size_px[1], dtype=np.float32)[:, None]
    return np.asarray(cv2.remap(pixels, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), dtype=np.uint8)


def _where_seen(pix: FloatArray, model: CameraModel, q_ned_frd: Quat, readout: Readout) -> FloatArray:
    """(N, 2) where the rows saw what lies at pix (N, 2) of the middle's picture."""
    R_ned_cam = R_from_quat(q_ned_frd) @ R_FRD_CAM
    rays = unproject(model, pix)
    descent = (rays @ R_ned_cam[2]) / np.linalg.norm(rays, axis=1)
    moves = (descent > MIN_DESCENT) & (readout.height_m > 0.0)
    per_depth = np.where(moves, (rays @ R_ned_cam[2]) / max(readout.height_m, 1.0), 0.0)
    v_cam = R_ned_cam.T @ np.array(readout.v_ned_mps)
    rate_cam = R_FRD_CAM.T @ np.array(readout.rate_frd_radps)
    seen = pix
    for _ in range(PASSES):
        t_s = (seen[:, 1] - (model.height_px - 1) / 2) / model.height_px * readout.readout_s
        points = rays - (per_depth * t_s)[:, None] * v_cam
        seen = project(model, _turned(points, -t_s[:, None] * rate_cam))
    return seen


def _turned(points: FloatArray, turns_rad: FloatArray) -> FloatArray:
    """(N, 3) each point turned about its own vector (N, 3) by the vector's length (Rodrigues)."""
    angle = np.linalg.norm(turns_rad, axis=1, keepdims=True)
    axis = turns_rad / np.maximum(angle, 1e-12)
    along = (axis * points).sum(1, keepdims=True)
    turned = points * np.cos(angle) + np.cross(axis, points) * np.sin(angle) + axis * along * (1 - np.cos(angle))
    return np.asarray(turned, dtype=np.float64)
