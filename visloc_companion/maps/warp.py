"""Resampling of a layer into a window: any affine or another CRS, anti-aliased, in chunks.

The level is chosen so that its pixels are at most as large as the window's, or nearly so; where the window's are more than
1.25 times larger, it is sampled twice as densely and averaged 2 x 2. Sampling is bicubic for pixels and bilinear for heights;
a window whose pixels are the layer's own is copied.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.geo.raster import apply_affine, compose_affine, invert_affine
from visloc_companion.maps.layer import Layer, Validity, Values
from visloc_companion.types import FloatArray

CHUNK_PX = 2048
"""Side of an affine chunk; OpenCV warps no source wider than 32767 pixels."""
KNOT_PX = 32
"""In another CRS every such pixel is placed exactly and those between bilinearly (1e-3 px at 1 m/px between UTM zones)."""
_SUPPORT_PX = 3
PixOfPix = Callable[[FloatArray], FloatArray]
"""(N, 2) pix of the window -> (N, 2) pix of the layer's level 0."""


@dataclass(frozen=True, slots=True, eq=False)
class _Chunk:
    """A part of the window: where it starts, its (rows, cols), and how densely it is sampled."""

    top: int
    left: int
    shape: tuple[int, int]
    factor: int

    @property
    def dense(self) -> tuple[int, int]:
        return self.shape[0] * self.factor, self.shape[1] * self.factor

    @property
    def T_pix_dense(self) -> FloatArray:
        offset = 0.5 / self.factor - 0.5
        return np.array([[1 / self.factor, 0.0, offset + self.left], [0.0, 1 / self.factor, offset + self.top]])


def warp_affine(layer: Layer, T_map_pix: FloatArray, size_px: tuple[int, int]) -> tuple[Values, NDArray[np.bool_]]:
    """Values and validity of a (width, height) window whose pix coordinates map by (2, 3) `T_map_pix`.

    Invalid pixels are 0 (uint8) or NaN (float32).
    """
    T_src_pix = compose_affine(invert_affine(layer.T_map_pix), T_map_pix)
    level, scale = choose_level(_ratio(T_src_pix), len(layer.shapes))
    T_level_pix = compose_affine(T_level_src(level), T_src_pix)
    shift = _whole_shift(T_level_pix, size_px)
    factor = 2 if scale > 1.25 else 1
    values, valid = _empty(layer, (size_px[1], size_px[0]))
    for chunk in _chunks(size_px, CHUNK_PX // factor, factor):
        part = slice(chunk.top, chunk.top + chunk.shape[0]), slice(chunk.left, chunk.left + chunk.shape[1])
        if shift is not None:
            _copy(layer, level, (shift[0] + chunk.left, shift[1] + chunk.top), values[part], valid[part])
        else:
            _warp_chunk(layer, level, compose_affine(T_level_pix, chunk.T_pix_dense), chunk, values[part], valid[part])
    return values, valid


def warp_places(layer: Layer, src_of_pix: PixOfPix, size_px: tuple[int, int]) -> tuple[Values, NDArray[np.bool_]]:
    """The same for a window related to the layer by any smooth function (another CRS)."""
    values, valid = _empty(layer, (size_px[1], size_px[0]))
    ratio = _local_ratio(src_of_pix, size_px)
    if not math.isfinite(ratio):
        return values, valid
    level, scale = choose_level(ratio, len(layer.shapes))
    factor = 2 if scale > 1.25 else 1
    for chunk in _chunks(size_px, 512, factor):
        part = slice(chunk.top, chunk.top + chunk.shape[0]), slice(chunk.left, chunk.left + chunk.shape[1])
        places = apply_affine(T_level_src(level), _dense_places(src_of_pix, chunk)).astype(np.float64)
        _remap_chunk(layer, level, places, chunk, values[part], valid[part])
    return values, valid


def choose_level(ratio: float, n_levels: int) -> tuple[int, float]:
    """Level to sample from for windows with pixels `ratio` times those of level 0, and how many of the level's pixels one of
    the window then spans (0.84 to 1.68 while there are levels)."""
    level = min(max(0, math.floor(math.log2(ratio) + 0.25)), n_levels - 1)
    return level, ratio / 2**level


def T_level_src(level: int) -> FloatArray:
    """(2, 3) from pix of level 0 to pix of a level."""
    k = 0.5**level
    return np.array([[k, 0.0, 0.5 * k - 0.5], [0.0, k, 0.5 * k - 0.5]])


def interpolate(layer: Layer, pix: FloatArray) -> FloatArray:
    """(N,) bilinear values of a one-channel layer at (N, 2) pix of level 0; NaN outside and amid invalid pixels."""
    rows, cols = layer.shapes[0]
    inside = ((pix >= -0.5) & (pix <= np.array([cols - 0.5, rows - 0.5]))).all(axis=1)
    result = np.full(len(pix), np.nan)
    if not inside.any():
        return result
    u, v = np.clip(pix[inside], 0, [cols - 1, rows - 1]).T
    left, top = int(u.min()), int(v.min())
    values, valid = layer.read(0, (top, min(rows, int(v.max()) + 2)), (left, min(cols, int(u.max()) + 2)))
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


def _chunks(size_px: tuple[int, int], side: int, factor: int) -> list[_Chunk]:
    width, height = size_px
    return [
        _Chunk(top, left, (min(side, height - top), min(side, width - left)), factor)
        for top in range(0, height, side)
        for left in range(0, width, side)
    ]


def _empty(layer: Layer, shape: tuple[int, int]) -> tuple[Values, NDArray[np.bool_]]:
    full = shape if layer.channels == 1 else (*shape, layer.channels)
    return np.full(full, 0 if layer.dtype == np.uint8 else np.nan, layer.dtype), np.zeros(shape, np.bool_)


def _ratio(T: FloatArray) -> float:
    return math.sqrt(abs(float(np.linalg.det(T[:, :2]))))


def _whole_shift(T: FloatArray, size_px: tuple[int, int]) -> tuple[int, int] | None:
    """The shift of a window whose pixels are the level's own (to 1e-3 px over the whole window), else None."""
    shift = np.rint(T[:, 2])
    corners = np.array([[0.0, 0.0], [size_px[0], 0.0], [0.0, size_px[1]], [size_px[0], size_px[1]]])
    off = apply_affine(T, corners) - corners - shift
    return (int(shift[0]), int(shift[1])) if float(np.abs(off).max()) < 1e-3 else None


def _copy(layer: Layer, level: int, start: tuple[int, int], values: Values, valid: NDArray[np.bool_]) -> None:
    rows, cols = layer.shapes[level]
    left, top = max(0, start[0]), max(0, start[1])
    right, bottom = min(cols, start[0] + valid.shape[1]), min(rows, start[1] + valid.shape[0])
    if right <= left or bottom <= top:
        return
    got, got_valid = layer.read(level, (top, bottom), (left, right))
    part = slice(top - start[1], bottom - start[1]), slice(left - start[0], right - start[0])
    valid[part] = got_valid > 0
    values[part] = got
    values[part][~valid[part]] = 0 if layer.dtype == np.uint8 else np.nan


def _warp_chunk(layer: Layer, level: int, T: FloatArray, chunk: _Chunk, values: Values, valid: NDArray[np.bool_]) -> None:
    """Fill one chunk; (2, 3) `T` maps its dense pix to the level's."""
    rows, cols = chunk.dense
    corners = np.array([[0.0, 0.0], [cols - 1, 0.0], [0.0, rows - 1], [cols - 1, rows - 1]])
    source = _source(layer, level, apply_affine(T, corners))
    if source is None:
        return
    pixels, share, origin = source
    T = T - np.column_stack([np.zeros((2, 2)), origin])
    size = (cols, rows)
    kernel = cv2.INTER_CUBIC if layer.dtype == np.uint8 else cv2.INTER_LINEAR
    out = cv2.warpAffine(pixels, T, size, flags=cv2.WARP_INVERSE_MAP | kernel, borderMode=cv2.BORDER_REPLICATE)
    got = cv2.warpAffine(share, T, size, flags=cv2.WARP_INVERSE_MAP | cv2.INTER_LINEAR)
    _finish(out, got, chunk, values, valid)


def _remap_chunk(layer: Layer, level: int, places: FloatArray, chunk: _Chunk, values: Values, valid: NDArray[np.bool_]) -> None:
    """Fill one chunk; `places` (rows, cols, 2) are the level's pix of its dense pixels."""
    source = _source(layer, level, places.reshape(-1, 2))
    if source is None:
        return
    pixels, share, origin = source
    relative = np.nan_to_num(places - origin, nan=-1e4).astype(np.float32)
    u, v = np.ascontiguousarray(relative[..., 0]), np.ascontiguousarray(relative[..., 1])
    kernel = cv2.INTER_CUBIC if layer.dtype == np.uint8 else cv2.INTER_LINEAR
    out = cv2.remap(pixels, u, v, kernel, borderMode=cv2.BORDER_REPLICATE)
    _finish(out, cv2.remap(share, u, v, cv2.INTER_LINEAR), chunk, values, valid)


def _finish(out: Values, share: Values, chunk: _Chunk, values: Values, valid: NDArray[np.bool_]) -> None:
    if chunk.factor > 1:
        size = chunk.shape[::-1]
        out, share = cv2.resize(out, size, interpolation=cv2.INTER_AREA), cv2.resize(share, size, interpolation=cv2.INTER_AREA)
    np.greater(share, 127, out=valid)
    if valid.all():
        values[...] = out
    else:
        values[valid] = out[valid]


def _source(layer: Layer, level: int, pix: FloatArray) -> tuple[Values, Validity, FloatArray] | None:
    """Pixels around (N, 2) places of a level, fit for interpolation; validity, shrunk around holes (not at the raster's edge) by
    what the kernel reaches; and the pix of their first pixel. None where no place is near the raster."""
    if not np.isfinite(pix).any():
        return None
    rows, cols = layer.shapes[level]
    low = np.maximum(np.floor(np.nanmin(pix, axis=0)) - _SUPPORT_PX, 0).astype(int)
    high = np.minimum(np.ceil(np.nanmax(pix, axis=0)) + _SUPPORT_PX + 1, [cols, rows]).astype(int)
    if not (high > low).all():
        return None
    values, valid = layer.read(level, (low[1], high[1]), (low[0], high[0]))
    if not valid.all():
        reach = 5 if layer.dtype == np.uint8 else 3
        if layer.dtype == np.float32:
            values = np.where(valid > 0, values, values[valid > 0].mean() if valid.any() else np.float32(0))
        valid = np.asarray(cv2.erode(valid, np.ones((reach, reach), np.uint8)), np.uint8)
    return np.ascontiguousarray(values), np.ascontiguousarray(valid), low.astype(np.float64)


def _local_ratio(src_of_pix: PixOfPix, size_px: tuple[int, int]) -> float:
    """Median size of the window's pixels in the layer's pixels, over a grid of places; NaN where none has a place."""
    u, v = np.meshgrid(np.linspace(0, size_px[0] - 1, 5), np.linspace(0, size_px[1] - 1, 5))
    pix = np.column_stack([u.ravel(), v.ravel()])
    here = src_of_pix(pix)
    right, down = src_of_pix(pix + np.array([1.0, 0.0])) - here, src_of_pix(pix + np.array([0.0, 1.0])) - here
    area = np.abs(right[:, 0] * down[:, 1] - right[:, 1] * down[:, 0])
    known = area[np.isfinite(area)]
    return math.sqrt(float(np.median(known))) if known.size else math.nan


def _dense_places(src_of_pix: PixOfPix, chunk: _Chunk) -> FloatArray:
    """(rows, cols, 2) places of the chunk's dense pixels: exact at knots, bilinear between."""
    rows, cols = chunk.dense
    n_v, n_u = (-(-n // KNOT_PX) + 1 for n in (rows, cols))
    u, v = np.meshgrid(KNOT_PX * np.arange(n_u), KNOT_PX * np.arange(n_v))
    knots = src_of_pix(apply_affine(chunk.T_pix_dense, np.column_stack([u.ravel(), v.ravel()]).astype(np.float64)))
    knots = knots.reshape(n_v, n_u, 2)
    share_u, share_v = np.arange(cols) / KNOT_PX, np.arange(rows) / KNOT_PX
    iu, iv = share_u.astype(int), share_v.astype(int)
    fu, fv = (share_u - iu)[None, :, None], (share_v - iv)[:, None, None]
    across = knots[:, iu] * (1 - fu) + knots[:, iu + 1] * fu
    return np.asarray(across[iv] * (1 - fv) + across[iv + 1] * fv, dtype=np.float64)
