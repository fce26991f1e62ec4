"""Exhaustive masked normalised correlation by FFT over position x heading x scale.

For every heading and scale the rectified frame's features T (mask m) are correlated with the map's M (validity w):

    score(s) = sum m w T . M(s) / sqrt( sum m w |T|^2  sum m w |M(s)|^2 )

(Padfield 2012, masked normalised cross-correlation; no mean is removed from features that have none, `zero_mean` for grey
values). The template lies at its offset from the camera's nadir, so an index of the result is the pixel of the nadir, for every
hypothesis the same grid.

Cost: the map is cut into blocks of a size that suits the template, never the map's, so that time is linear in the searched area
A once that is larger than a template, with the logarithm of the block's size for a factor:

    time = K C (A + template's area) a log2(block's area)

for K hypotheses of C channels; measured 5 to 8 ns of one core for each position, hypothesis and channel at 90 px footprints
(`benchmarks/search_cost.py`). Memory: the spectra of the map, 4 C bytes a position times the blocks' overlap, at most
SPECTRA_BYTES at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.parabola import peak_offset
from visloc_companion.localise.spectra import BlockCorrelator, Box, Complex64Array, block_size, paired

MIN_OVERLAP = 0.5
LEAST_DEVIATION = 1.0
"""Of brightness under a template (0 to 255), for `zero_mean`: what varies less shows nothing but noise."""
SPECTRA_BYTES, SPECTRA_OVERHEAD = 48 << 20, 2.5
"""Limit of the map's spectra, and their size for one position over that of its features, because blocks overlap."""
NO_SCORE = -1.0


@dataclass(frozen=True, slots=True, eq=False)
class Template:
    """Rectified frame of one hypothesis: features (h, w, C), mask (h, w) and the nadir's offset of its first pixel (u, v)."""

    features: Float32Array
    mask: Float32Array
    offset_px: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class ScoreVolume:
    """Scores at nadir pixels `origin_px` + (column, row): best over the hypotheses, and which one. -1: too little overlap."""

    score: Float32Array
    hypothesis: NDArray[np.int32]
    origin_px: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Peak:
    """A local maximum: nadir pixel (u, v) in the window, hypothesis number, score."""

    u_px: float
    v_px: float
    hypothesis: int
    score: float


def search(
    features: Float32Array,
    weight: Float32Array,
    make_template: Callable[[int], Template],
    n_hypotheses: int,
    box_px: Box,
    extent_px: Box,
    zero_mean: bool = False,
    threads: int = 1,
) -> ScoreVolume:
    """Scores of all hypotheses at the nadir pixels of a box.

    `features` (H, W, C) and `weight` (H, W) are the map window's. `box_px` is (u_first, v_first, u_last, v_last) of the nadir in
    window pixels (may lie outside the window), `extent_px` the same of all templates about the nadir. `make_template` must be
    pure: with `threads` > 1 it is called from several threads. The result does not depend on their number.
    """
    if zero_mean:  # the variance under a template is the difference of two sums, which a common brightness drowns
        features = features - np.einsum("ijk,ij->k", features, weight) / np.float32(max(float(weight.sum()), 1.0))
    workers = max(1, min(threads, n_hypotheses))
    shares = [range(n_hypotheses * t // workers, n_hypotheses * (t + 1) // workers) for t in range(workers)]
    parts = []
    for strip in _strips(box_px, extent_px, features.shape[2]):
        of_fields, of_sums = _spectra(features, weight, strip, extent_px, n_hypotheses, zero_mean)
        run = partial(_best, of_fields, of_sums, make_template, zero_mean)
        if workers == 1:
            parts.append(run(shares[0]))
        else:
            with ThreadPoolExecutor(workers) as pool:
                parts.append(_merged(list(pool.map(run, shares))))
    best, which = (np.concatenate([part[k] for part in parts]) for k in range(2))
    return ScoreVolume(best, which, (box_px[0], box_px[1]))


def find_peaks(volume: ScoreVolume, allowed: NDArray[np.bool_], radius_px: float, count: int) -> list[Peak]:
    """The highest maxima at least `radius_px` apart, best first, among the allowed positions. Sub-pixel by a parabola.

    A position that only leads up to a neighbour is none: what is cut out about a peak leaves its slope standing.
    """
    score = np.where(allowed, volume.score, -1.0).astype(np.float32)
    score[score < cv2.dilate(score, np.ones((3, 3), np.uint8))] = -1.0
    peaks = []
    for _ in range(count):
        row, col = np.unravel_index(int(np.argmax(score)), score.shape)
        value = float(score[row, col])
        if value <= 0:
            break
        du, dv = peak_offset(volume.score, int(row), int(col))
        peaks.append(
            Peak(
                volume.origin_px[0] + int(col) + du, volume.origin_px[1] + int(row) + dv, int(volume.hypothesis[row, col]), value
            )
        )
        cv2.circle(score, (int(col), int(row)), max(1, round(radius_px)), -1.0, -1)
    return peaks


def _spectra(
    features: Float32Array, weight: Float32Array, strip: Box, extent: Box, n_hypotheses: int, zero_mean: bool
) -> tuple[BlockCorrelator, BlockCorrelator]:
    """Spectra of the map about a strip: its weighted features; and its weight, their energy, for `zero_mean` their first too."""
    u0, v0, u1, v1 = strip
    top = max(0, v0 + extent[1])
    rows = slice(top, max(top, v1 + extent[3] + 1))
    seen, valid = features[rows], weight[rows]
    fields, squares = _weighted(seen, valid)
    sums = paired(np.stack([valid, squares], -1))
    if zero_mean:
        sums = np.concatenate([sums, fields[:1]])
        fields = fields + np.complex64(1j) * valid  # one channel leaves the imaginary part free for the weight itself
    box = (u0, v0 - top, u1, v1 - top)
    size = block_size(box, extent, len(fields) + len(sums), n_hypotheses)
    return BlockCorrelator(fields, box, extent, size), BlockCorrelator(sums, box, extent, size)


def _best(
    fields: BlockCorrelator, sums: BlockCorrelator, make_template: Callable[[int], Template], zero_mean: bool, hypotheses: range
) -> tuple[Float32Array, NDArray[np.int32]]:
    """Best score and its hypothesis at each position, the lower hypothesis of equals. `hypotheses` ascend."""
    shape = (fields.blocks[-1][0].stop, fields.blocks[-1][1].stop)
    best, which = np.full(shape, NO_SCORE, np.float32), np.zeros(shape, np.int32)
    of_features, of_mask = fields.room(), sums.room(1)
    for k in hypotheses:
        template = make_template(k)
        values, area = template.features, max(float(template.mask.sum()), 1.0)
        if zero_mean:
            values = values - np.einsum("ijk,ij->k", values, template.mask) / np.float32(area)
        masked, squares = _weighted(values, template.mask)
        energy = float(squares.sum(dtype=np.float64))
        fields.transform(masked, template.offset_px, of_features)
        sums.transform(template.mask[None], template.offset_px, of_mask)
        for block, at in enumerate(fields.blocks):
            product = fields.summed(block, of_features)
            score = _score(product, sums.each(block, of_mask), area, energy)
            better = score > best[at]
            np.maximum(best[at], score, out=best[at])
            np.maximum(which[at], np.multiply(better, np.int32(k)), out=which[at])
    return best, which


def _weighted(values: Float32Array, weight: Float32Array) -> tuple[Complex64Array, Float32Array]:
    """(K, H, W) complex64 channels two by two times a weight (H, W), and (H, W) the weighted sum of their squares."""
    pairs = paired(values)
    parts = pairs.view(np.float32)  # real and imaginary part side by side
    squares = np.einsum("kij,kij->ij", parts, parts)
    parts *= np.repeat(weight, 2, axis=1)
    return pairs, (squares[:, ::2] + squares[:, 1::2]) * weight


def _score(products: Complex64Array, sums: list[Complex64Array], area: float, energy: float) -> Float32Array:
    """Scores (rows, cols) from sum m w T . M, for `zero_mean` + i sum m w T; sum m w + i sum m w |M|^2; for `zero_mean`
    sum m w M; sum m; sum m |T|^2."""
    product: Float32Array = products.real
    seen: Float32Array = sums[0].real
    under: Float32Array = sums[0].imag
    if len(sums) > 1:  # where a part of the template is off the map, neither mean is that of the whole
        product = np.asarray(product - products.imag * sums[1].real / np.maximum(seen, 1), dtype=np.float32)
        under = np.asarray(under - np.square(sums[1].real) / np.maximum(seen, 1), dtype=np.float32)
        under = np.maximum(under, LEAST_DEVIATION**2 * seen)
    share = seen * np.float32(1 / area)
    own = np.minimum(share, np.float32(1)) * np.float32(energy)
    score: Float32Array = product / np.sqrt(np.maximum(own * under, np.float32(1e-6 * area * area + 1e-6)))
    little = share < MIN_OVERLAP
    if little.any():
        score[little] = NO_SCORE
    return score


def _merged(parts: list[tuple[Float32Array, NDArray[np.int32]]]) -> tuple[Float32Array, NDArray[np.int32]]:
    """The better of each position, the earlier part (the lower hypotheses) of equals."""
    best, which = parts[0]
    for score, hypothesis in parts[1:]:
        better = score > best
        np.copyto(best, score, where=better)
        np.copyto(which, hypothesis, where=better)
    return best, which


def _strips(box: Box, extent: Box, channels: int) -> Iterator[Box]:
    """The box in strips whose map spectra fit SPECTRA_BYTES."""
    u0, v0, u1, v1 = box
    reach = extent[3] - extent[1] + 1
    rows = max(reach, int(SPECTRA_BYTES / (SPECTRA_OVERHEAD * 4 * channels * (u1 - u0 + 1 + extent[2] - extent[0]))))
    for first in range(v0, v1 + 1, rows):
        yield u0, first, u1, min(v1, first + rows - 1)
