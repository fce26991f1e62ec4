"""How far two orthophotos of one place lie apart: their gradients correlated over many windows, all surfaces added up.

Each window alone may have changed; what all of them have in common is where one picture lies on the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.base import without_margin
from visloc_companion.localise.features.gradient import gradient_features
from visloc_companion.localise.parabola import peak_offset
from visloc_companion.types import FloatArray

SIDE_PX, LEAST_SIDE_PX, REACH_PX, WINDOWS = 160, 48, 24, 8
"""Side of a window, that on small maps, how far it is searched, and how many there are on a side of the map at most."""
LEAST_VALID, LEAST_CONTENT = 0.5, 0.05
"""Share of a window with pixels, and root mean square of its features: what has less is all alike."""
PEAK_PX, LEAST_Z = 3, 8.0
"""A peak stands out by so many robust sigmas of what lies further than PEAK_PX from it."""
FACTORS = (1, 4, 16)
"""Pixels that a shift is looked for in, times the finest: each reaches as many times as far."""
LEAST_PARTS = 4
"""Windows that show a shift of their own, from which on these tell whether one picture is bent against the other."""
Window = Callable[[FloatArray, tuple[int, int]], tuple[NDArray[np.uint8], NDArray[np.bool_]]]
"""(2, 3) `T_map_pix` and (width, height) to pixels and validity."""


@dataclass(frozen=True, slots=True)
class Shift:
    """How far the second lies east and north of the first (map units), and how far parts of it lie from there (root mean square
    of an axis, no less than the noise of a window); NaN where too few tell."""

    east: float
    north: float
    parts: float


def shift_between(first: Window, second: Window, bounds: tuple[float, float, float, float], pixel: float) -> Shift | None:
    """The shift between two pictures within `bounds` (west, south, east, north), to a fraction of a pixel (all map units); None
    where none stands out. It is looked for in coarser pixels where these show none: so far is seen only with them."""
    for factor in FACTORS:
        found = _shift(first, second, bounds, factor * pixel)
        if found is None or factor == 1:
            fine = found
        else:
            rest = _shift(first, _moved(second, found), bounds, pixel)
            fine = None if rest is None else Shift(found.east + rest.east, found.north + rest.north, rest.parts)
        if fine is not None:
            return fine
    return None


def _shift(first: Window, second: Window, bounds: tuple[float, float, float, float], pixel: float) -> Shift | None:
    """What one pixel's windows show."""
    west, south, east, north = bounds
    side_px = int(min(SIDE_PX, max(LEAST_SIDE_PX, min(east - west, north - south) // pixel)))
    surfaces: list[FloatArray] = []
    for corner in _corners(bounds, side_px * pixel):
        near, wide = _features(first, corner, pixel, side_px, 0), _features(second, corner, pixel, side_px, REACH_PX)
        if near is not None and wide is not None:
            size = float(np.linalg.norm(near)) * float(np.linalg.norm(wide))
            surfaces.append(np.asarray(cv2.matchTemplate(wide, near, cv2.TM_CCORR), dtype=np.float64) / size)
    whole = _peak(np.sum(surfaces, axis=0)) if surfaces else None
    if whole is None:
        return None
    parts = [part - whole for part in map(_peak, surfaces) if part is not None]
    apart = float(np.sqrt(np.mean(np.square(parts)))) * pixel if len(parts) >= LEAST_PARTS else math.nan
    return Shift(float(whole[0]) * pixel, -float(whole[1]) * pixel, apart)


def _moved(window: Window, shift: Shift) -> Window:
    """The same picture, looked at where a shift says that it lies."""
    offset = np.array([[0.0, 0.0, shift.east], [0.0, 0.0, shift.north]])
    return lambda T_map_pix, size_px: window(T_map_pix + offset, size_px)


def _peak(surface: FloatArray) -> FloatArray | None:
    """(2,) shift to the right and down of a correlation's peak, pixels; None where none stands out, or at the border."""
    row, col = (int(k) for k in np.unravel_index(int(np.argmax(surface)), surface.shape))
    if not (0 < row < surface.shape[0] - 1 and 0 < col < surface.shape[1] - 1):
        return None
    v, u = np.mgrid[: surface.shape[0], : surface.shape[1]]
    rest = surface[np.maximum(np.abs(v - row), np.abs(u - col)) > PEAK_PX]
    middle = float(np.median(rest))
    sigma = 1.4826 * float(np.median(np.abs(rest - middle)))
    if float(surface[row, col]) - middle < LEAST_Z * max(sigma, 1e-9):
        return None
    du, dv = peak_offset(surface, row, col)
    return np.array([col - REACH_PX + du, row - REACH_PX + dv])


def _corners(bounds: tuple[float, float, float, float], side: float) -> list[tuple[float, float]]:
    """North-west corners of windows of a side (all map units), spread evenly over the map."""
    west, south, east, north = bounds
    firsts = []
    for extent in (east - west, north - south):
        n = int(min(WINDOWS, max(1, extent // side)))
        firsts.append((np.arange(n) + 0.5) * extent / n - side / 2)
    return [(west + float(right), north - float(down)) for down in firsts[1] for right in firsts[0]]


def _features(
    window: Window, corner: tuple[float, float], pixel: float, side_px: int, margin_px: int
) -> NDArray[np.float32] | None:
    """(side + 2 margins, same, 2) gradient features of a window; None where it shows too little."""
    west, north = corner
    T_map_pix = np.array([[pixel, 0.0, west + (0.5 - margin_px) * pixel], [0.0, -pixel, north - (0.5 - margin_px) * pixel]])
    grown_px = side_px + 2 * margin_px
    pixels, valid = window(T_map_pix, (grown_px, grown_px))
    if without_margin(valid, margin_px).mean() < LEAST_VALID:
        return None
    features = gradient_features(pixels, valid)
    return features if float(np.sqrt(np.mean(features**2))) >= LEAST_CONTENT else None
