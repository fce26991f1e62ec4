"""A frame made ready to be followed: undistorted, evened out, and drawn as the keyframe would have seen it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.frame import full_level
from visloc_companion.localise.structure.contrast import as_bytes, evened
from visloc_companion.localise.structure.tracks import BORDER_PX, SMOOTHING_PX
from visloc_companion.types import CameraModel, FloatArray, Image

COARSE = 4
"""The first guess of a shift is made on pictures reduced so much."""
LEAST_RESPONSE = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """(H, W) grey, undistorted and evened out, where it may be looked at (H, W), and the pinhole matrix (3, 3)."""

    grey: Image
    seen: NDArray[np.bool_]
    K: FloatArray

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.grey.shape[1], self.grey.shape[0]

    def normalised(self, pix: FloatArray) -> FloatArray:
        """(N, 2) pixels to normalised coordinates."""
        return np.asarray((pix - self.K[:2, 2]) / np.array([self.K[0, 0], self.K[1, 1]]), dtype=np.float64)

    def rays(self, pix: FloatArray) -> FloatArray:
        """(N, 3) directions in `cam`, third component 1."""
        return np.column_stack([self.normalised(pix), np.ones(len(pix))])


def prepared(pixels: Image, model: CameraModel) -> Picture:
    """The picture that corners are sought and followed in."""
    level = full_level(pixels, model)
    smooth = np.asarray(cv2.GaussianBlur(level.grey + 0.5, (0, 0), SMOOTHING_PX), dtype=np.uint8)
    return Picture(as_bytes(evened(smooth)), _inner(level.valid), level.K)


def warped(picture: Picture, H_frame_key: FloatArray) -> tuple[Image, NDArray[np.bool_]]:
    """The frame on the keyframe's pixels by the homography that maps those to the frame's, and where it shows anything."""
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    image = cv2.warpPerspective(picture.grey, H_frame_key, picture.size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    seen = picture.seen.astype(np.uint8)
    flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    return np.asarray(image, dtype=np.uint8), cv2.warpPerspective(seen, H_frame_key, picture.size, flags=flags) > 0


def shift_between(key: Image, frame: Image) -> FloatArray | None:
    """(2,) pixels from the content of `key` to that of `frame` (phase correlation); None where nothing stands out."""
    size = (key.shape[1] // COARSE, key.shape[0] // COARSE)
    a, b = (cv2.resize(p, size, interpolation=cv2.INTER_AREA).astype(np.float32) for p in (key, frame))
    window = cv2.createHanningWindow(size, cv2.CV_32F)
    shift, response = cv2.phaseCorrelate(a, b, window)
    return COARSE * np.array(shift) if response > LEAST_RESPONSE else None


def plane_homography(
    K: FloatArray, R_ned_key: FloatArray, R_ned_frame: FloatArray, d_ned_m: FloatArray, h_m: float
) -> FloatArray:
    """(3, 3) frame-from-keyframe homography of the level plane `h_m` below the keyframe's camera, for a displacement (3,)."""
    plane = np.eye(3) - np.outer(d_ned_m, [0.0, 0.0, 1.0 / h_m])
    return np.asarray(K @ R_ned_frame.T @ plane @ R_ned_key @ np.linalg.inv(K), dtype=np.float64)


def through(H: FloatArray, pix: FloatArray) -> FloatArray:
    """(N, 2) pixels through a homography."""
    p = np.column_stack([pix, np.ones(len(pix))]) @ H.T
    return np.asarray(p[:, :2] / p[:, 2:3], dtype=np.float64)


def _inner(valid: NDArray[np.uint8]) -> NDArray[np.bool_]:
    side = 2 * BORDER_PX + 1
    return np.asarray(cv2.erode(valid, np.ones((side, side), np.uint8), borderValue=0) > 0, dtype=np.bool_)
