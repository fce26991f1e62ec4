"""Blocks of the frame, each matched to the map on its own: correspondences for the pose, and an independent check."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid, ground_points
from visloc_companion.localise.parabola import peak_offset
from visloc_companion.localise.spectra import correlated_within, paired
from visloc_companion.types import FloatArray

REACH_PX = 6
AGREE_PX = 2.0
RETURN_PX = 1.5
MIN_COVER = 0.6
CHANCE_SIDE_PX, TELLING_SIDE_PX = 14.0, 28.0
"""Peaks of blocks of the former side are chance as much as likeness, and few agree though the place is right; those of the latter
tell good blocks from bad ones."""
LEAST_PEAK = 0.02
MOST_NORMALISED, LEAST_ENERGY = 4, 1e-6
"""Channels that OpenCV normalises; share of a block's energy that is less than rounding leaves where there is none."""
FEW_AGREE, LEAST_SHARE = 0.5, 0.2
"""Where fewer than this share of the blocks agree, those that do are in part there by chance, too, and all of them tell less: as
the square of the share, but no less than for that one. Under a tilt that is not known they disagree where the place is right."""


@dataclass(frozen=True, slots=True, eq=False)
class BlockMatches:
    """Centres (N, 2) in grid pixels, displacement (N, 2) of what the frame shows against the map (grid pixels), peak (N,) of
    the normalised correlation, and whether the displacement is small enough to agree (N,); the blocks' side in grid pixels."""

    centre_px: FloatArray
    shift_px: FloatArray
    peak: FloatArray
    agrees: FloatArray
    side_px: int


def match_blocks(grid: MapGrid, frame: Float32Array, weight: Float32Array) -> BlockMatches:
    """Match blocks of the rectified frame's features (H, W, C) within ±REACH_PX of where the pose puts them."""
    side = block_side_px(weight)
    return matches_of(correlated(grid, frame, weight, side, REACH_PX), side)


def block_side_px(weight: Float32Array) -> int:
    """Side of the blocks of a rectified frame that is seen with `weight` (H, W)."""
    return int(np.clip(round(np.sqrt(float(weight.sum())) / 6), 14, 40))


def matches_of(blocks: Iterable[tuple[int, int, Float32Array]], side_px: int) -> BlockMatches:
    """What blocks show, by the peaks of their correlations within ±REACH_PX (`correlated`)."""
    found = [(left + (side_px - 1) / 2, top + (side_px - 1) / 2, *_peak(score)) for left, top, score in blocks]
    table = np.array(found, dtype=np.float64).reshape(-1, 5)
    agrees = (np.hypot(table[:, 2], table[:, 3]) < AGREE_PX).astype(np.float64)
    return BlockMatches(table[:, :2], table[:, 2:4], table[:, 4], agrees, side_px)


def curvatures(scores: Sequence[Float32Array]) -> FloatArray:
    """(N, 2, 2) by how much each of N correlations falls off about its peak, right and down; second differences."""
    parts = np.empty((len(scores), 3, 3))
    for part, score in zip(parts, scores, strict=True):
        _, _, _, (col, row) = cv2.minMaxLoc(score)
        row, col = min(max(row, 1), score.shape[0] - 2), min(max(col, 1), score.shape[1] - 2)
        part[:] = score[row - 1 : row + 2, col - 1 : col + 2]
    uu = 2 * parts[:, 1, 1] - parts[:, 1, 0] - parts[:, 1, 2]
    vv = 2 * parts[:, 1, 1] - parts[:, 0, 1] - parts[:, 2, 1]
    uv = (parts[:, 0, 2] + parts[:, 2, 0] - parts[:, 0, 0] - parts[:, 2, 2]) / 4
    return np.stack([uu, uv, uv, vv], axis=1).reshape(-1, 2, 2)


def correlated(
    grid: MapGrid, frame: Float32Array, weight: Float32Array, side_px: int, reach_px: int
) -> Iterator[tuple[int, int, Float32Array]]:
    """Left and top of each block of a side of which enough is seen, in the rectified frame's features (H, W, C) with `weight`
    (H, W), and its normalised correlation (2 reach + 1, 2 reach + 1) with the map about where the pose puts it."""
    rows, cols = np.flatnonzero(weight.any(1)), np.flatnonzero(weight.any(0))
    if not len(rows) or rows[-1] - rows[0] < side_px or cols[-1] - cols[0] < side_px:
        return
    bordered = cv2.copyMakeBorder(grid.features * grid.weight[..., None], *(reach_px,) * 4, cv2.BORDER_CONSTANT, value=0)
    template, masked = np.asarray(bordered, dtype=np.float32), frame * weight[..., None]
    reached_px, places_px, cover = side_px + 2 * reach_px, 2 * reach_px + 1, _sums(weight, (side_px, side_px))
    many = frame.shape[2] > MOST_NORMALISED
    if many:  # what blocks and their windows share is worked out once
        fields, of_frame = paired(template), paired(masked)
        under, own = (_sums(_energy(values), (side_px, side_px)) for values in (template, masked))
    for top in _starts(rows[0], rows[-1] + 1, side_px):
        for left in _starts(cols[0], cols[-1] + 1, side_px):
            if cover[top, left] < MIN_COVER * side_px**2:
                continue
            block, window = _square(top, left, side_px), _square(top, left, reached_px)
            if many:
                product = correlated_within(fields[:, *window], of_frame[:, *block]).real
                yield left, top, _normalised(product, under[_square(top, left, places_px)], own[top, left])
            else:
                yield left, top, normalised_correlation(template[window], masked[block])


def worth(matches: BlockMatches, tilt_known: bool = True) -> FloatArray:
    """(N,) share of each block's information on the pose that counts: by its peak against the median of all, and by how many
    agree under a tilt that is known; neither counts for small blocks."""
    if not len(matches.peak):
        return np.zeros(0)
    peak = np.clip(matches.peak, LEAST_PEAK, 1.0)
    telling = np.clip((matches.side_px - CHANCE_SIDE_PX) / (TELLING_SIDE_PX - CHANCE_SIDE_PX), 0.0, 1.0)
    by_peak = np.asarray((peak / np.median(peak)) ** telling, dtype=np.float64)
    if not tilt_known:
        return by_peak
    agreeing = float(np.clip(matches.agrees.mean() / FEW_AGREE, LEAST_SHARE / FEW_AGREE, 1.0))
    return np.asarray(by_peak * agreeing ** (2 * telling), dtype=np.float64)


def share_returning(matches: BlockMatches, grid: MapGrid, frame: Float32Array, weight: Float32Array) -> float:
    """Share of the blocks that agree and come back: the map's block at the same place, searched in the frame, answers with the
    opposite displacement (forward-backward check, Kalal, Mikolajczyk & Matas 2010)."""
    if not len(matches.agrees):
        return 0.0
    swapped = MapGrid(frame * weight[..., None], (weight > 0).astype(np.float32), grid.surface_up_m, grid.A_ne_pix, grid.gsd_m)
    back = match_blocks(swapped, grid.features, weight)
    apart = np.hypot(*(matches.shift_px + back.shift_px).T)
    return float(np.mean((apart < RETURN_PX) & (matches.agrees > 0)))


def normalised_correlation(window: Float32Array, block: Float32Array) -> Float32Array:
    """(H - h + 1, W - w + 1) normalised correlation of (h, w, C) features at all offsets in (H, W, C).

    OpenCV normalises no more than four channels, and correlates each by a transform of its own: beyond, they go two by two.
    """
    if block.shape[2] <= MOST_NORMALISED:
        return np.asarray(cv2.matchTemplate(window, block, cv2.TM_CCORR_NORMED), dtype=np.float32)
    product = correlated_within(paired(window), paired(block)).real
    height, width = product.shape
    return _normalised(product, _sums(_energy(window), block.shape[:2])[:height, :width], float(np.square(block).sum()))


def _normalised(product: Float32Array, under: FloatArray, own: float) -> Float32Array:
    """A block's correlation (rows, cols), from the sum of the squares under the block at each place and that of its own."""
    least = LEAST_ENERGY * own
    return np.asarray(product / np.sqrt(np.maximum(np.maximum(under, least) * own, 1e-12)), dtype=np.float32)


def _energy(values: Float32Array) -> Float32Array:
    """(H, W) sum of the squares of all channels (H, W, C)."""
    return np.asarray(np.einsum("ijk,ijk->ij", values, values), dtype=np.float32)


def _sums(values: Float32Array, size_px: tuple[int, int]) -> FloatArray:
    """(H, W) sums of (H, W) values over (rows, cols) from each pixel on, zero beyond the border."""
    border = cv2.BORDER_CONSTANT
    sums = cv2.boxFilter(values, cv2.CV_64F, size_px[::-1], anchor=(0, 0), normalize=False, borderType=border)
    return np.asarray(sums, dtype=np.float64)


def _square(top: int, left: int, side_px: int) -> tuple[slice, slice]:
    return slice(top, top + side_px), slice(left, left + side_px)


def correspondences(
    matches: BlockMatches, grid: MapGrid, K: FloatArray, pose: CameraPose
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Ground points (N, 3) NED, undistorted frame pixels (N, 2) and one grid pixel in frame pixels (N,) for the pose.

    What the frame shows at a block's centre, by the pose that rectified it, lies on the ground where the block was matched.
    """
    at, ground = ground_points(grid, matches.centre_px), ground_points(grid, matches.centre_px + matches.shift_px)
    q = (at - pose.p_ned_m) @ pose.R_ned_cam
    pix = q[:, :2] / q[:, 2:3] * np.array([K[0, 0], K[1, 1]]) + np.array([K[0, 2], K[1, 2]])
    return ground, pix, K[0, 0] * grid.gsd_m / np.maximum(q[:, 2], 1.0)


def _starts(first: int, last: int, side: int) -> list[int]:
    count = max(2, round((last - first) / side))
    return [round(float(x)) for x in np.linspace(first, last - side, count)]


def _peak(scores: Float32Array) -> tuple[float, float, float]:
    _, value, _, (col, row) = cv2.minMaxLoc(scores)
    du = dv = 0.0
    if 0 < col < scores.shape[1] - 1 and 0 < row < scores.shape[0] - 1:
        du, dv = peak_offset(scores, row, col)
    return col + du - REACH_PX, row + dv - REACH_PX, float(value)
