"""Dense disparity of a rectified pair: semi-global matching (Hirschmüller 2008), then a least-squares step on the pictures.

The matcher's own sub-pixel values lock onto whole pixels; a few Gauss-Newton steps of a window's disparity (Lucas-Kanade along
the row) do not, and their normal equation gives each disparity its sigma.

Evened out, the noise of snow or of a field tells one disparity from another as pictures that show something do. What resembles
by chance is left out by a smooth matcher and by a correlation over more than the window of the step; the step keeps its window,
for what it claims falls with it.
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
STEP, JUMP = 32 * BLOCK_PX**2, 128 * BLOCK_PX**2
"""What a disparity costs that is one or more off its neighbour's (P1, P2 of Hirschmüller). With a quarter, and a
correlation of 0.5 over the window of the step, 26 % of a cloud's points over snow are off by more than 1 m (median; seeds 30 to
35 of benchmarks/structure_chain.py), so 15 %."""
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
        P1=STEP,
        P2=JUMP,
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
    value, sigma, correlation = _refined(left, right, np.maximum(coarse, 0), settings)
    common = pair.left_seen & seen_in_right(pair, np.where(matched, value, np.float32(pair.count / 2)))
    good = matched & common & (correlation >= settings.min_correlation) & (sigma <= settings.max_sigma_px)
    good &= np.abs(value - coarse) <= FARTHEST_STEP_PX
    return Disparity(value, sigma, good, common)


def _refined(
    left: Float32Array, right: Float32Array, disparity: Float32Array, settings: StereoSettings
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Disparity, 1-sigma and correlation at every pixel after STEPS Gauss-Newton steps."""
    half = settings.window_half_px
    height, width = left.shape
    v = np.ascontiguousarray(np.broadcast_to(np.arange(height, dtype=np.float32)[:, None], left.shape))
    u = np.arange(width, dtype=np.float32)[None, :]
    window = (2 * half + 1, 2 * half + 1)
    smooth = cv2.medianBlur(disparity, 3)
    value = np.where(np.abs(smooth - disparity) < 1, smooth, disparity).astype(np.float32)
    slope_left = _slope(left)
    slope_right = _slope(right)
    left_mean = cv2.blur(left, window)
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
    freedom = np.float32(window[0] * window[1] / 4)  # neighbouring pixels share what the lens and the resampling spread
    sigma = cv2.sqrt(cv2.blur(apart * apart, window) / (steepness * freedom) + np.float32(SIGMA_FLOOR_PX**2))
    correlation = _correlation(left, np.asarray(there, dtype=np.float32), settings.correlation_half_px)
    return value, np.asarray(sigma, dtype=np.float32), correlation


def _correlation(a: Float32Array, b: Float32Array, half: int) -> Float32Array:
    """Of the windows about every pixel."""
    window = (2 * half + 1, 2 * half + 1)
    mean_a, mean_b = cv2.blur(a, window), cv2.blur(b, window)
    power_a, power_b = (cv2.blur(x * x, window) - mean * mean for x, mean in ((a, mean_a), (b, mean_b)))
    shared = cv2.blur(a * b, window) - mean_a * mean_b
    return np.asarray(shared / cv2.sqrt(np.maximum(power_a * power_b, np.float32(1e-12))), dtype=np.float32)


def _slope(image: Float32Array) -> Float32Array:
    return np.asarray(cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=1, scale=0.5), dtype=np.float32)
