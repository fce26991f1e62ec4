"""Masked normalised correlation of height maps over position x heading x scale, by FFT.

    score(s) = sqrt(o) sum n (T - mean T)(M - mean M) / sqrt(sum n (T - mean T)^2  sum n (M - mean M)^2)

over the cells n known in both the source's map T and the reference's M(s), the means over these cells alone (Padfield 2012,
Masked object registration in the Fourier domain): a height between the clouds, holes and borders do not matter.
o is the share of the source that n is: a correlation over few cells is by chance as high as a lower one over many. The reference
is cut into blocks (localise/spectra.py): time is K A log(block) for K hypotheses over A cells, memory 40 bytes a cell.
The six sums are real; two go through one transform as real and imaginary part, so that three transforms give them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.base import Float32Array, Mask
from visloc_companion.localise.registration.height_map import HeightMap
from visloc_companion.localise.spectra import BlockCorrelator, Box, Complex64Array, block_size

MIN_OVERLAP = 0.25
"""Share of the source's known cells that must lie on known reference."""
NO_SCORE = -1.0
LEAST_DEVIATION_M = 0.02
"""Surfaces flatter than this have no shape: their correlation is that of rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class Template:
    """Heights (h, w) of one hypothesis, zero where not `known` (h, w); offset (u, v) of its first cell from the position.

    `handicap` is taken from its scores."""

    height_m: Float32Array
    known: Mask
    offset: tuple[int, int]
    handicap: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """(rows, cols) best score over the hypotheses at each position of a box, and which; `origin` (u, v) of its first cell.

    `unseen`: share of what was to be searched that has no score, for want of overlap."""

    score: Float32Array
    hypothesis: NDArray[np.int32]
    origin: tuple[int, int]
    unseen: float = 0.0


class HeightCorrelator:
    """Spectra of a reference's heights over a box of positions (cells), for templates that lie within an extent about them."""

    def __init__(self, reference: HeightMap, box: Box, extent: Box, n_templates: int) -> None:
        known = reference.known.astype(np.float32)
        self._level = np.float32(np.median(reference.height_m[reference.known])) if known.any() else np.float32(0)
        height = (reference.height_m - self._level) * known
        first = (known + 1j * height).astype(np.complex64)
        second = np.stack([known, 1j * np.square(height)]).astype(np.complex64)
        size = block_size(box, extent, 3, n_templates)
        self._first, self._second = (BlockCorrelator(f, box, extent, size) for f in (first[None], second))
        self._box = box

    def scores(self, templates: Iterable[Template]) -> Scores:
        """Best of the templates at each position; the lower one of equals."""
        u0, v0, u1, v1 = self._box
        best = np.full((v1 - v0 + 1, u1 - u0 + 1), NO_SCORE, np.float32)
        which = np.zeros(best.shape, np.int32)
        for k, template in enumerate(templates):
            mask = template.known.astype(np.float32)
            area = max(float(mask.sum()), 1.0)
            level = np.float32((template.height_m * mask).sum() / area)
            height = (template.height_m - level) * mask
            of = self._first.spectrum(np.stack([height, np.square(height), mask]), template.offset)
            for block, at in enumerate(self._first.blocks):
                sums = self._first.each(block, of[2:])[0], self._first.each(block, of[:1])[0], self._second.summed(block, of[1:])
                score = _score(*sums, area) - np.float32(template.handicap)
                better = score > best[at]
                np.copyto(best[at], score, where=better)
                np.copyto(which[at], np.int32(k), where=better)
        return Scores(best, which, (u0, v0))


def _score(of_one: Complex64Array, of_height: Complex64Array, of_squares: Complex64Array, area: float) -> Float32Array:
    """Scores from sum n + i sum n M; sum n T + i sum n T M; and sum n T^2 + i sum n M^2."""
    n, of_m = np.maximum(of_one.real, np.float32(1)), of_one.imag
    of_t, of_tm = of_height.real, of_height.imag
    covariance = of_tm - of_t * of_m / n
    least = n * np.float32(LEAST_DEVIATION_M**2)
    spread_t = np.maximum(of_squares.real - of_t * of_t / n, least)
    spread_m = np.maximum(of_squares.imag - of_m * of_m / n, least)
    overlap = np.minimum(n / np.float32(area), np.float32(1))
    score = np.asarray(covariance * np.sqrt(overlap / (spread_t * spread_m)), dtype=np.float32)
    score[overlap < MIN_OVERLAP] = NO_SCORE
    return score


def summits(score: Float32Array) -> Mask:
    """(rows, cols) which positions are no lower than their eight neighbours."""
    if not score.size:
        return np.zeros(score.shape, np.bool_)
    return np.asarray(score == cv2.dilate(score, np.ones((3, 3), np.uint8)))


def peaks(scores: Scores, apart: float, most: int) -> list[tuple[int, int, int, float]]:
    """(u, v, hypothesis, score) of the highest positions at least so many cells from each other, best first."""
    if not scores.score.size:
        return []
    left = np.where(summits(scores.score), scores.score, np.float32(NO_SCORE))
    rows, cols = np.ogrid[: left.shape[0], : left.shape[1]]
    found = []
    for _ in range(most):
        row, col = (int(k) for k in np.unravel_index(int(np.argmax(left)), left.shape))
        if left[row, col] <= NO_SCORE:
            break
        found.append((col + scores.origin[0], row + scores.origin[1], int(scores.hypothesis[row, col]), float(left[row, col])))
        left[(rows - row) ** 2 + (cols - col) ** 2 < apart**2] = NO_SCORE
    return found
