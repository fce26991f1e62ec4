"""Resampling of a layer into a window: any affine, anti-aliased, in chunks.

The level is chosen so that its pixels are at most as large as the window's, or nearly so; where the window's are more than
1.25 times larger, it is sampled twice as densely and averaged 2 x 2. Sampling is bicubic for pixels and bilinear for heights.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.geo.raster import compose_affine, invert_affine
from visloc_companion.maps.layer import Layer, Validity, Values
from visloc_companion.types import FloatArray

CHUNK_PX = 2048
"""Side of a chunk; OpenCV warps no source wider than 32767 pixels."""
_SUPPORT_PX = 3


def warp_affine(layer: Layer, T_map_pix: FloatArray, size_px: tuple[int, int]) -> tuple[Values, NDArray[np.bool_]]:
    """Values and validity of a (width, height) window whose pix coordinates map by (2, 3) `T_map_pix`.

    Invalid pixels are 0 (uint8) or NaN (float32).
    """
    T_src_pix = compose_affine(invert_affine(layer.T_map_pix), T_map_pix)
    level, scale = choose_level(T_src_pix, len(layer.shapes))
    T_level_src = np.array([[0.5**level, 0.0, 0.5 * 0.5**level - 0.5], [0.0, 0.5**level, 0.5 * 0.5**level - 0.5]])
    T_level_pix = compose_affine(T_level_src, T_src_pix)
    width, height = size_px
    values = np.empty((height, width) if layer.channels == 1 else (height, width, layer.channels), layer.dtype)
    valid = np.empty((height, width), np.bool_)
    factor = 2 if scale > 1.25 else 1
    side = CHUNK_PX // factor
    for top in range(0, height, side):
        for left in range(0, width, side):
            part = (slice(top, min(top + side, height)), slice(left, min(left + side, width)))
            shape = (part[0].stop - top, part[1].stop - left)
            T_chunk = compose_affine(T_level_pix, np.array([[1.0, 0.0, left], [0.0, 1.0, top]]))
            values[part], valid[part] = _warp_chunk(layer, level, T_chunk, shape, factor)
    return values, valid


def choose_level(T_src_pix: FloatArray, n_levels: int) -> tuple[int, float]:
    """Level to sample from, and how many of its pixels one pixel of the window then spans (0.84 to 1.68, if there are levels)."""
    ratio = math.sqrt(abs(float(np.linalg.det(T_src_pix[:, :2]))))
    level = min(max(0, math.floor(math.log2(ratio) + 0.25)), n_levels - 1)
    return level, ratio / 2**level


def _warp_chunk(
    layer: Layer, level: int, T_level_pix: FloatArray, shape: tuple[int, int], factor: int
) -> tuple[Values, NDArray[np.bool_]]:
    """One chunk of (rows, cols), sampled `factor` times as densely as asked and averaged."""
    dense = (shape[0] * factor, shape[1] * factor)
    offset = 0.5 / factor - 0.5
    T = compose_affine(T_level_pix, np.array([[1 / factor, 0.0, offset], [0.0, 1 / factor, offset]]))
    empty = np.zeros if layer.dtype == np.uint8 else _nan
    window = _source_window(T, dense, layer.shapes[level])
    if window is None:
        return empty(shape if layer.channels == 1 else (*shape, layer.channels), layer.dtype), np.zeros(shape, np.bool_)
    rows, cols = window
    values, valid = layer.read(level, rows, cols)
    T = T - np.array([[0.0, 0.0, cols[0]], [0.0, 0.0, rows[0]]])
    share = _warp_validity(valid, T, dense, 5 if layer.dtype == np.uint8 else 3)
    flags = cv2.WARP_INVERSE_MAP | (cv2.INTER_CUBIC if layer.dtype == np.uint8 else cv2.INTER_LINEAR)
    if layer.dtype == np.float32 and not valid.all():
        values = np.where(valid > 0, values, _mean_of_valid(values, valid))
    out: Values = cv2.warpAffine(np.ascontiguousarray(values), T, dense[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
    if factor > 1:
        out = cv2.resize(out, shape[::-1], interpolation=cv2.INTER_AREA)
        share = np.asarray(cv2.resize(share, shape[::-1], interpolation=cv2.INTER_AREA), np.uint8)
    inside = share > 127
    out[~inside] = 0 if layer.dtype == np.uint8 else np.nan
    return out, inside


def _warp_validity(valid: Validity, T: FloatArray, shape: tuple[int, int], reach_px: int) -> Validity:
    """Validity shrunk around holes by what the kernel reaches, not at the raster's edge, and resampled bilinearly."""
    if not valid.all():
        valid = np.asarray(cv2.erode(valid, np.ones((reach_px, reach_px), np.uint8)), np.uint8)
    flags = cv2.WARP_INVERSE_MAP | cv2.INTER_LINEAR
    return np.asarray(cv2.warpAffine(np.ascontiguousarray(valid), T, shape[::-1], flags=flags), np.uint8)


def _mean_of_valid(values: Values, valid: Validity) -> np.float32:
    inside = values[valid > 0]
    return np.float32(inside.mean(dtype=np.float64)) if inside.size else np.float32(0)


def _nan(shape: tuple[int, ...], dtype: np.dtype[np.float32]) -> Values:
    return np.full(shape, np.nan, dtype)


def _source_window(
    T_src_pix: FloatArray, shape: tuple[int, int], source: tuple[int, int]
) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """Rows and columns of the source that a chunk needs; None where it needs none."""
    corners = np.array([[u, v] for u in (0, shape[1] - 1) for v in (0, shape[0] - 1)], np.float64)
    uv = corners @ T_src_pix[:, :2].T + T_src_pix[:, 2]
    low = np.floor(uv.min(axis=0)) - _SUPPORT_PX
    high = np.ceil(uv.max(axis=0)) + _SUPPORT_PX + 1
    low, high = np.maximum(low, 0), np.minimum(high, [source[1], source[0]])
    if not (high > low).all():
        return None
    return (int(low[1]), int(high[1])), (int(low[0]), int(high[0]))


def interpolate(layer: Layer, pix: FloatArray, level: int = 0) -> FloatArray:
    """(N,) bilinear values of one level of a one-channel layer at (N, 2) pix of level 0; NaN outside and amid invalid pixels."""
    rows, cols = layer.shapes[level]
    u, v = ((pix + 0.5) / 2**level - 0.5).T
    inside = (u >= -0.5) & (v >= -0.5) & (u <= cols - 0.5) & (v <= rows - 0.5)
    result = np.full(len(pix), np.nan)
    if not inside.any():
        return result
    u, v = np.clip(u[inside], 0, cols - 1), np.clip(v[inside], 0, rows - 1)
    left, top = int(u.min()), int(v.min())
    values, valid = layer.read(level, (top, min(rows, int(v.max()) + 2)), (left, min(cols, int(u.max()) + 2)))
    u, v = u - left, v - top
    u0, v0 = u.astype(int), v.astype(int)
    u1, v1 = np.minimum(u0 + 1, values.shape[1] - 1), np.minimum(v0 + 1, values.shape[0] - 1)
    fu, fv = u - u0, v - v0
    total, weight = np.zeros(len(u)), np.zeros(len(u))
    for row, col, w in ((v0, u0, (1 - fu) * (1 - fv)), (v0, u1, fu * (1 - fv)), (v1, u0, (1 - fu) * fv), (v1, u1, fu * fv)):
        use = np.where(valid[row, col] > 0, w, 0.0)
        total += use * np.where(use > 0, values[row, col], 0.0)
        weight += use
    result[inside] = np.where(weight > 1e-6, total / np.maximum(weight, 1e-6), np.nan)
    return result
