"""What motion does to a picture while it is taken: rows at their own times (rolling shutter), and smear over the exposure."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from visloc_companion.geo.camera import R_FRD_CAM, pinhole_matrix
from visloc_companion.geo.se3 import R_from_quat
from visloc_companion.sim.rendering.render_effects import CameraEffects
from visloc_companion.types import CameraModel, FloatArray, Image, Quat, Vec3

STEP_PX = 1.0
MOST_STEPS = 24


@dataclass(frozen=True, slots=True)
class Shot:
    """How a picture is taken: the camera's velocity and body rates, and for how long it is exposed.

    The last row is exposed `readout_s` after the first; place and attitude hold for the middle one. Every row is exposed for
    `exposure_s`. `effects` None takes the camera's own.
    """

    v_ned_mps: Vec3 = (0.0, 0.0, 0.0)
    rate_frd_radps: Vec3 = (0.0, 0.0, 0.0)
    readout_s: float = 0.0
    exposure_s: float = 0.0
    effects: CameraEffects | None = None


STILL = Shot()


def row_times_s(rows: int, readout_s: float) -> FloatArray:
    """When each row is exposed, seconds from the middle one (rows,); one zero where all are at the same time."""
    return np.zeros(1) if readout_s == 0.0 else (np.arange(rows) - (rows - 1) / 2) / rows * readout_s


def turning(R_ned_frd: FloatArray, rate_frd_radps: Vec3, t_s: FloatArray) -> FloatArray:
    """(N, 3, 3) attitudes at times (N,) about now, turning at constant body rates (Rodrigues)."""
    turns = [cv2.Rodrigues(np.array(rate_frd_radps) * t)[0] for t in t_s]
    return np.asarray(R_ned_frd @ np.array(turns), dtype=np.float64)


def smeared(pixels: Image, model: CameraModel, q_ned_frd: Quat, height_m: float, shot: Shot) -> Image:
    """The mean of the picture over its exposure, the ground taken as level `height_m` below. Lens distortion is not followed.

    Each moment's picture is the middle one seen through the homography of the ground plane.
    """
    if shot.exposure_s <= 0.0 or height_m <= 0.0:
        return pixels
    half = _homography(model, q_ned_frd, height_m, shot, shot.exposure_s / 2)
    corners = np.array([[[0.0, 0.0], [model.width_px, 0.0], [0.0, model.height_px], [model.width_px, model.height_px]]])
    reach_px = 2 * float(np.abs(cv2.perspectiveTransform(corners, half) - corners).max())
    if reach_px < STEP_PX / 2:
        return pixels
    steps = min(MOST_STEPS, 2 + int(reach_px / STEP_PX))
    total = np.zeros(pixels.shape, np.float32)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    for t in np.linspace(-0.5, 0.5, steps) * shot.exposure_s:
        to_middle = _homography(model, q_ned_frd, height_m, shot, float(t))
        size = (model.width_px, model.height_px)
        total += cv2.warpPerspective(pixels, to_middle, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(total / steps + 0.5, dtype=np.uint8)


def _homography(model: CameraModel, q_ned_frd: Quat, height_m: float, shot: Shot, t_s: float) -> FloatArray:
    """(3, 3) from a pixel at a time about the middle of the exposure to the pixel of the same ground in the middle."""
    K = pinhole_matrix(model)
    R_middle = R_from_quat(q_ned_frd)
    R_then = turning(R_middle, shot.rate_frd_radps, np.array([t_s]))[0]
    # X_ned from the camera then is X + v t from the camera in the middle; on the plane down = height: n . X = height
    moved = np.eye(3) + np.outer(np.array(shot.v_ned_mps) * t_s, np.array([0.0, 0.0, 1.0])) / height_m
    M = (R_middle @ R_FRD_CAM).T @ moved @ (R_then @ R_FRD_CAM)
    return np.asarray(K @ M @ np.linalg.inv(K), dtype=np.float64)
