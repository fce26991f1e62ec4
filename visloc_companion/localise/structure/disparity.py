"""Dense disparity of a rectified pair: semi-global matching (Hirschmüller 2008), then a least-squares step on the pictures.

The matcher's own sub-pixel values lock onto whole pixels; a few Gauss-Newton steps of a window's disparity (Lucas-Kanade along
the row) do not, and their normal equation gives each disparity its sigma.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.structure.base import StereoSettings
from visloc_companion.localise.structure.contrast import as_bytes, evened
from visloc_companion.localise.structure.rectify import RectifiedPair, seen_in_right

BLOCK_PX = 3
SPECKLE_PX, SPECKLE_STEP_PX = 60, 2
UNIQUENESS_PERCENT = 5
LEFT_RIGHT_PX = 1
STEPS = 2
FARTHEST_STEP_PX = 1.0
SIGMA_FLOOR_PX = 0.05
"""What resampling and the lens leave of error where a window's own scatter claims less."""


@dataclass(frozen=True, slots=True, eq=False)
class Disparity:
    """(H, W) disparity in the pair's pixels and its 1-sigma, and which are to be trusted; `common` is where both frames look."""

    value_px: Float32Array
    sigma_px: Float32Array
    good: NDArray[np.bool_]
    common: NDArray[np.bool_]


def match(pair: RectifiedPair, settings: StereoSettings) -> Disparity:
    """Disparities with left-right, uniqueness, texture and correlation checks."""
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=pair.count,
        blockSize=BLOCK_PX,
        P1=8 * BLOCK_PX**2,
        P2=32 * BLOCK_PX**2,
        disp12MaxDiff=LEFT_RIGHT_PX,
        preFilterCap=31,
        uniquenessRatio=UNIQUENESS_PERCENT,
        speckleWindowSize=SPECKLE_PX,
        speckleRange=SPECKLE_STEP_PX,
        mode=cv2.STEREO_SGBM_MODE_SGBM,
    )
    left, right = evened(pair.left), evened(pair.right)
    coarse = np.asarray(matcher.compute(as_bytes(left), as_bytes(right)), dtype=np.float32) / np.float32(16)
    matched = coarse >= 0
    value, sigma, correlation = _refined(left, right, np.maximum(coarse, 0), settings.window_half_px)
    common = pair.left_seen & seen_in_right(pair, np.where(matched, value, np.float32(pair.count / 2)))
    good = matched & common & (correlation >= settings.min_correlation) & (sigma <= settings.max_sigma_px)
    good &= np.abs(value - coarse) <= FARTHEST_STEP_PX
    return Disparity(value, sigma, good, common)


def _refined(
    left: Float32Array, right: Float32Array, disparity: Float32Array, half: int
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Disparity, 1-sigma and correlation of every window after STEPS Gauss-Newton steps."""
    height, width = left.shape
    v = np.ascontiguousarray(np.broadcast_to(np.arange(height, dtype=np.float32)[:, None], left.shape))
    u = np.arange(width, dtype=np.float32)[None, :]
    window = (2 * half + 1, 2 * half + 1)
    smooth = cv2.medianBlur(disparity, 3)
    value = np.where(np.abs(smooth - disparity) < 1, smooth, disparity).astype(np.float32)
    slope_left = _slope(left)
    slope_right = _slope(right)
    left_mean = cv2.blur(left, window)
    left_power = cv2.blur(left * left, window) - left_mean * left_mean
    for step in range(STEPS + 1):
        there = cv2.remap(right, u - value, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        slope = cv2.remap(slope_right, u - value, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        mean = cv2.blur(there, window)
        apart = (left - left_mean) - (there - mean)
        steepness = np.maximum(cv2.blur(slope * slope_left, window), np.float32(1e-6))
        if step == STEPS:
            break
        pull = cv2.blur((slope + slope_left) * np.float32(0.5) * apart, window)
        value = value - np.clip(pull / steepness, -0.5, 0.5).astype(np.float32)
    power = cv2.blur(there * there, window) - mean * mean
    shared = cv2.blur(left * there, window) - left_mean * mean
    correlation = shared / cv2.sqrt(np.maximum(left_power * power, np.float32(1e-12)))
    freedom = np.float32(window[0] * window[1] / 4)  # neighbouring pixels share what the lens and the resampling spread
    sigma = cv2.sqrt(cv2.blur(apart * apart, window) / (steepness * freedom) + np.float32(SIGMA_FLOOR_PX**2))
    return value, np.asarray(sigma, dtype=np.float32), np.asarray(correlation, dtype=np.float32)


def _slope(image: Float32Array) -> Float32Array:
    return np.asarray(cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=1, scale=0.5), dtype=np.float32)
