"""Where the pixels of a virtual pinhole camera lie in a frame, whatever lens took it."""

from __future__ import annotations

import cv2
import numpy as np

from visloc_companion.geo.camera import pinhole_matrix
from visloc_companion.localise.features.base import Float32Array
from visloc_companion.types import CameraModel, FloatArray


def where_seen(
    model: CameraModel, R_view_cam: FloatArray, K_view: FloatArray, size_px: tuple[int, int]
) -> tuple[Float32Array, Float32Array]:
    """(H, W) columns and rows in a frame of `model` of the pixels of a view with that attitude (3, 3), matrix (3, 3) and size
    (width, height), both cameras at one place. What the frame does not show is outside of it, as far as the lens reaches."""
    K, coefficients = pinhole_matrix(model), np.array(model.distortion)
    if model.distortion_model == "fisheye":
        maps = cv2.fisheye.initUndistortRectifyMap(K, coefficients, R_view_cam, K_view, size_px, cv2.CV_32FC1)
    else:
        maps = cv2.initUndistortRectifyMap(K, coefficients, R_view_cam, K_view, size_px, cv2.CV_32FC1)
    map_u, map_v = (np.asarray(of_axis, dtype=np.float32) for of_axis in maps)
    return map_u, map_v
