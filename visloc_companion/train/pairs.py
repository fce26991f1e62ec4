"""Training pairs: a piece of one date as the map, a turned and scaled piece of another as the frame, at a known place."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.network_input import network_input
from visloc_companion.train.augment import changed, leaned, mixed_bands, photographed
from visloc_companion.train.shapes import paint_dates
from visloc_companion.train.sources import Stack

Float32Array = NDArray[np.float32]
Rng = np.random.Generator
PLACES_TRIED = 100
HEIGHT_PER_SIDE = 0.5 / math.tan(math.radians(30))
"""Height above ground over the side of the footprint, for a camera of 60 degrees."""
EMPTY_SHARE = 0.02
"""So much of a piece may be empty: specks of the nodata value are land that happens to have it."""


@dataclass(frozen=True, slots=True)
class PairSettings:
    """`reference_px`: side of the map piece; `windows_px`: sides of the frame's raster; its footprint is `footprint_share`
    of that, at any angle. Turn and scale are what the network must bear, the misfits what the search grid leaves over.
    """

    reference_px: int = 144
    windows_px: tuple[int, ...] = (48, 56, 64, 80, 100)
    footprint_share: float = 0.8
    turn_rad: float = math.radians(11)
    log_scale: float = 0.1
    misfit_turn_rad: float = math.radians(1.5)
    misfit_log_scale: float = 0.015
    misfit_tilt_rad: float = 0.0
    same_date_share: float = 0.05
    change_share: float = 0.4
    photometric: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """`reference` (3, R, R) and `query` (3, Q, Q) network inputs, `query_valid` (Q, Q) the mask of the latter, float32.

    `window_to_query` (2, 3): pixels of the upright window to the query's, `turn_rad` is the turn in it; `offset_px` (2,):
    place of the window's first pixel (u, v) in the reference.
    """

    reference: Float32Array
    query: Float32Array
    query_valid: Float32Array
    window_to_query: Float32Array
    turn_rad: float
    offset_px: Float32Array


class StackPyramid:
    """A stack with its dates reduced by powers of two, for pieces at any coarser scale."""

    def __init__(self, stack: Stack) -> None:
        self.name, self._shift = stack.name, stack.shift_px
        self._levels = [list(stack.dates)]
        while min(self._levels[-1][0].shape[:2]) >= 320:
            self._levels.append([_halved(image) for image in self._levels[-1]])
        self.dates = len(stack.dates)
        self.shape = stack.dates[0].shape[:2]
        self._empty = None if stack.valid.all() else (~stack.valid).astype(np.uint8)

    def empty_share(self, A_source_piece: NDArray[np.float64], size_px: int) -> float:
        """How much of a piece (as for `piece`) some date shows no land of, 0 to 1."""
        if self._empty is None:
            return 0.0
        flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        return float(cv2.warpAffine(self._empty, A_source_piece, (size_px, size_px), flags=flags).mean())

    def piece(self, rng: Rng, date: int, A_source_piece: NDArray[np.float64], size_px: int) -> Float32Array:
        """(size, size) grey of a date. `A_source_piece` (2, 3) maps its pixels to the common grid."""
        scale = math.sqrt(abs(np.linalg.det(A_source_piece[:, :2])))
        k = min(len(self._levels) - 1, max(0, math.floor(math.log2(max(scale, 1.0)) + 1e-9)))
        A = A_source_piece.copy()
        A[:, 2] += self._shift[date]
        factor = 2.0**-k
        A = A * factor
        A[:, 2] += (factor - 1) / 2
        image = self._levels[k][date]
        corners = A[:, :2] @ np.array([[0, size_px, 0, size_px], [0, 0, size_px, size_px]]) + A[:, 2:]
        low = np.maximum(np.floor(corners.min(1)).astype(int) - 4, 0)
        high = np.ceil(corners.max(1)).astype(int) + 5
        grey = mixed_bands(rng, image[low[1] : high[1], low[0] : high[0]])
        A[:, 2] -= low
        rest = scale * factor
        if rest > 1.1:
            grey = cv2.GaussianBlur(grey, (0, 0), 0.5 * math.sqrt(rest * rest - 1)).astype(np.float32)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(
            cv2.warpAffine(grey, A, (size_px, size_px), flags=flags, borderMode=cv2.BORDER_REFLECT), dtype=np.float32
        )


def _halved(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Means of 2 x 2 pixels; an odd last row or column is left out, which would stretch the others by a share of a pixel."""
    height, width = (side // 2 for side in image.shape[:2])
    even = image[: 2 * height, : 2 * width]
    return np.asarray(cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


class PaintedStack:
    """Invented places (train/shapes.py), a new one for each pair."""

    name = "shapes"
    dates = 2

    def __init__(self, rng: Rng, size_px: int) -> None:
        self.shape = (size_px, size_px)
        self._images = paint_dates(rng, size_px)

    def empty_share(self, A_source_piece: NDArray[np.float64], size_px: int) -> float:
        """See StackPyramid.empty_share: there is land all over."""
        return 0.0

    def piece(self, rng: Rng, date: int, A_source_piece: NDArray[np.float64], size_px: int) -> Float32Array:
        """See StackPyramid.piece."""
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        image = self._images[date]
        return np.asarray(
            cv2.warpAffine(image, A_source_piece, (size_px, size_px), flags=flags, borderMode=cv2.BORDER_REFLECT),
            dtype=np.float32,
        )


def make_pair(
    rng: Rng, stack: StackPyramid | PaintedStack, settings: PairSettings, window_px: int, scales: tuple[float, float]
) -> Pair:
    """A random pair of a stack; `scales`: range of common-grid pixels to a pixel of the pair.

    Of up to `PLACES_TRIED` places the first is taken that all dates show, or the one that they show most of.
    """
    R, Q = settings.reference_px, window_px
    centre = np.full(2, (Q - 1) / 2)
    least_empty = math.inf
    for _ in range(PLACES_TRIED):
        drawn = _drawn(rng, stack, settings, Q, scales)
        empty = max(stack.empty_share(drawn.A_source_ref, R), stack.empty_share(drawn.A_source_query, Q))
        if empty < least_empty:
            least_empty, place = empty, drawn
        if empty <= EMPTY_SHARE:
            break
    A_source_ref, A_source_query = place.A_source_ref, place.A_source_query
    a, b, turn, log_scale, offset = place.map_date, place.frame_date, place.turn_rad, place.log_scale, place.offset_px
    reference = stack.piece(rng, a, A_source_ref, R)
    query = stack.piece(rng, b, A_source_query, Q)
    if settings.misfit_tilt_rad > 0:  # else nothing is drawn: the pairs of runs without it stay the same
        tilt, towards = rng.uniform(0, 1) * settings.misfit_tilt_rad, rng.uniform(0, 2 * math.pi)
        query = leaned(query, tilt, towards, HEIGHT_PER_SIDE * settings.footprint_share * Q)
    if rng.random() < settings.change_share:
        query = changed(rng, query, np.ascontiguousarray(reference[::-1]))
    reference, query = (photographed(rng, image, settings.photometric) for image in (reference, query))
    misfit = rng.uniform(-1, 1, 2) * (settings.misfit_turn_rad, settings.misfit_log_scale)
    valid = _footprint(rng, Q, settings.footprint_share)
    whole = np.ones((R, R), bool)
    return Pair(
        network_input(reference, whole),
        network_input(query, valid),
        valid.astype(np.float32),
        _about(turn + misfit[0], math.exp(log_scale + misfit[1]), centre).astype(np.float32),
        turn + misfit[0],
        offset.astype(np.float32),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """Where a pair is cut: dates, what takes pixels of map piece and frame to the source, and the frame's place in the piece."""

    map_date: int
    frame_date: int
    A_source_ref: NDArray[np.float64]
    A_source_query: NDArray[np.float64]
    turn_rad: float
    log_scale: float
    offset_px: NDArray[np.float64]


def _drawn(
    rng: Rng, stack: StackPyramid | PaintedStack, settings: PairSettings, window_px: int, scales: tuple[float, float]
) -> _Place:
    R, Q = settings.reference_px, window_px
    A_source_ref = _placed(rng, stack.shape, R, scales)
    a = int(rng.integers(stack.dates))
    b = a if rng.random() < settings.same_date_share else int((a + rng.integers(1, stack.dates)) % stack.dates)
    turn, log_scale = rng.uniform(-1, 1, 2) * (settings.turn_rad, settings.log_scale)
    offset = rng.uniform(0, R - Q, 2)
    back = _about(-turn, math.exp(-log_scale), np.full(2, (Q - 1) / 2))  # query pixel -> window pixel
    return _Place(a, b, A_source_ref, _compose(A_source_ref, _shifted(back, offset)), turn, log_scale, offset)


def _placed(rng: Rng, shape: tuple[int, int], side: int, scales: tuple[float, float]) -> NDArray[np.float64]:
    """(2, 3) piece -> source of a square at any angle (and mirrored at random) within a source."""
    angle = rng.uniform(0, 2 * math.pi)
    spread = abs(math.cos(angle)) + abs(math.sin(angle))
    largest = (min(shape) - 3) / (side * spread)
    low, high = min(scales[0], largest), min(scales[1], largest)
    scale = math.exp(rng.uniform(math.log(low), math.log(high)))
    half = scale * side * spread / 2 + 1
    centre = np.array([rng.uniform(half, shape[1] - half), rng.uniform(half, shape[0] - half)])
    linear = _about(angle, scale, np.zeros(2))[:, :2]
    if rng.random() < 0.5:
        linear = linear @ np.diag([1.0, -1.0])
    return np.column_stack([linear, centre - linear @ np.full(2, (side - 1) / 2)])


def _about(turn: float, scale: float, centre: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2, 3): turn and scale about a centre."""
    c, s = scale * math.cos(turn), scale * math.sin(turn)
    linear = np.array([[c, -s], [s, c]])
    return np.column_stack([linear, centre - linear @ centre])


def _compose(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.column_stack([first[:, :2] @ second[:, :2], first[:, :2] @ second[:, 2] + first[:, 2]])


def _shifted(A: NDArray[np.float64], offset: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.column_stack([A[:, :2], A[:, 2] + offset])


def _footprint(rng: Rng, side: int, share: float) -> NDArray[np.bool_]:
    """(side, side) mask of a rectangle of about (share * side)² at any angle: what a frame shows on the map's axes."""
    aspect = rng.uniform(1.0, 1.35)
    size = (share * side * math.sqrt(aspect), share * side / math.sqrt(aspect))
    box = cv2.boxPoints((((side - 1) / 2, (side - 1) / 2), size, float(rng.uniform(0, 180))))
    mask = np.zeros((side, side), np.uint8)
    cv2.fillPoly(mask, [np.rint(box).astype(np.int32)], 1)
    return mask > 0
