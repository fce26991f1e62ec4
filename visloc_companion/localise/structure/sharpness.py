"""How blurred a picture is, from its own edges: gradient energy at a fine and at a coarse scale.

Pictures of the ground have about as much gradient energy in each octave of area (power falls with the square of frequency), so
behind Gaussians of sigma s the energy goes with 1 / (s² + b²), b being the picture's own blur: the ratio of two scales gives b.
A smear has a direction: the least ratio over four directions counts. Smears longer than 15 px come out too short, the longest
at about COARSE_PX.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from visloc_companion.localise.features.base import Float32Array
from visloc_companion.types import Image

FINE_PX, COARSE_PX = 2.0, 8.0


def blur_px(grey: Image) -> float:
    """1-sigma of the blur in the most blurred of four directions, pixels; infinite where nothing stands out at all."""
    fine, coarse = _energies(grey, FINE_PX), _energies(grey, COARSE_PX)
    if float(coarse.max()) < 1e-4:
        return math.inf
    ratio = float((fine / np.maximum(coarse, 1e-6)).min())
    if ratio <= 1.0:
        return math.inf
    return math.sqrt(max(0.0, (COARSE_PX**2 - ratio * FINE_PX**2) / (ratio - 1.0)))


def _energies(grey: Image, sigma_px: float) -> Float32Array:
    """(4,) mean squared derivative across, down and along both diagonals behind a Gaussian."""
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), sigma_px)
    x, y = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=0.125), cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=0.125)
    xx, yy, xy = (float((a * b).mean()) for a, b in ((x, x), (y, y), (x, y)))
    return np.array([xx, yy, (xx + yy) / 2 + xy, (xx + yy) / 2 - xy], np.float32)
