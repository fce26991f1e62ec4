"""Exhaustive masked normalised correlation by FFT over position x heading x scale.

For every heading and scale the rectified frame's features T (mask m) are correlated with the map's M (validity w):

    score(s) = sum m w T . M(s) / sqrt( sum m w |T|^2  sum m w |M(s)|^2 )

(Padfield 2012, masked normalised cross-correlation; no mean is removed from features that have none, `zero_mean` for grey
values). The template lies in the FFT array at its offset from the camera's nadir, so an index of the result is the pixel of the
nadir, for every hypothesis the same grid.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.base import Float32Array

MIN_OVERLAP = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Template:
    """Rectified frame of one hypothesis: features (h, w, C), mask (h, w) and the nadir's offset of its first pixel (u, v)."""

    features: Float32Array
    mask: Float32Array
    offset_px: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class ScoreVolume:
    """Scores at nadir pixels `origin_px` + (column, row): best over the hypotheses, which one, and the overlap there."""

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
    box_px: tuple[int, int, int, int],
    extent_px: tuple[int, int, int, int],
    zero_mean: bool = False,
) -> ScoreVolume:
    """Scores of all hypotheses at the nadir pixels of a box.

    `features` (H, W, C) and `weight` (H, W) are the map window's. `box_px` is (u_first, v_first, u_last, v_last) of the nadir in
    window pixels (may lie outside the window), `extent_px` the same of all templates about the nadir.
    """
    height, width = weight.shape
    u0, v0, u1, v1 = box_px
    left, top = min(0, u0 + extent_px[0]), min(0, v0 + extent_px[1])
    size = (
        cv2.getOptimalDFTSize(max(width, u1 + extent_px[2] + 1) - left),
        cv2.getOptimalDFTSize(max(height, v1 + extent_px[3] + 1) - top),
    )
    window = _MapSpectra(features, weight, size, zero_mean)
    rows = np.arange(v0, v1 + 1) % size[1]
    cols = np.arange(u0, u1 + 1) % size[0]
    best = np.full((len(rows), len(cols)), -1.0, np.float32)
    which = np.zeros(best.shape, np.int32)
    for k in range(n_hypotheses):
        score = window.correlate(make_template(k))[np.ix_(rows, cols)]
        better = score > best
        best[better] = score[better]
        which[better] = k
    return ScoreVolume(best, which, (u0, v0))


def find_peaks(volume: ScoreVolume, allowed: NDArray[np.bool_], radius_px: float, count: int) -> list[Peak]:
    """The highest maxima at least `radius_px` apart, best first, among the allowed positions. Sub-pixel by a parabola."""
    score = np.where(allowed, volume.score, -1.0).astype(np.float32)
    peaks = []
    for _ in range(count):
        row, col = np.unravel_index(int(np.argmax(score)), score.shape)
        value = float(score[row, col])
        if value <= 0:
            break
        du, dv = _parabola(volume.score, int(row), int(col))
        peaks.append(
            Peak(
                volume.origin_px[0] + int(col) + du, volume.origin_px[1] + int(row) + dv, int(volume.hypothesis[row, col]), value
            )
        )
        cv2.circle(score, (int(col), int(row)), max(1, round(radius_px)), -1.0, -1)
    return peaks


def _parabola(score: Float32Array, row: int, col: int) -> tuple[float, float]:
    offsets = []
    for line, k in ((score[row], col), (score[:, col], row)):
        if not 0 < k < len(line) - 1:
            offsets.append(0.0)
            continue
        a, b, c = (float(x) for x in line[k - 1 : k + 2])
        curvature = a - 2 * b + c
        offsets.append(max(-0.5, min(0.5, 0.5 * (a - c) / curvature)) if curvature < -1e-9 else 0.0)
    return offsets[0], offsets[1]


class _MapSpectra:
    """Transforms of the map window, shared by all hypotheses."""

    def __init__(self, features: Float32Array, weight: Float32Array, size: tuple[int, int], zero_mean: bool) -> None:
        self._size = size
        self._zero_mean = zero_mean
        weighted = features * weight[..., None]
        self._channels = [self._forward(weighted[..., k]) for k in range(features.shape[2])]
        self._energy = self._forward(np.einsum("ijk,ijk->ij", weighted, features))
        self._weight = self._forward(weight)

    def correlate(self, template: Template) -> Float32Array:
        """Scores on the FFT grid; -1 where too little of the template lies on valid map."""
        mask = self._placed(template.mask, template.offset_px)
        masked = template.features * template.mask[..., None]
        if self._zero_mean:
            masked = masked - template.mask[..., None] * (masked.sum((0, 1)) / max(float(template.mask.sum()), 1.0))
        parts = [_product(s, self._placed(masked[..., k], template.offset_px)) for k, s in enumerate(self._channels)]
        numerator = self._inverse(np.sum(parts, axis=0, dtype=np.float32))
        seen = self._inverse(_product(self._weight, mask))
        under = self._inverse(_product(self._energy, mask))
        area = max(float(template.mask.sum()), 1.0)
        if self._zero_mean:
            mean = self._inverse(_product(self._channels[0], mask))
            under = np.asarray(under - mean * mean / np.maximum(seen, 1.0), dtype=np.float32)
        share = seen / area
        own = float(np.sum(masked * masked)) * np.clip(share, 0, 1)
        score = numerator / np.sqrt(np.maximum(own * under, 1e-6 * area * area + 1e-6))
        return np.where(share >= MIN_OVERLAP, score, -1.0).astype(np.float32)

    def _placed(self, values: Float32Array, offset_px: tuple[int, int]) -> Float32Array:
        array = np.zeros((self._size[1], self._size[0]), np.float32)
        rows = (np.arange(values.shape[0]) + offset_px[1]) % self._size[1]
        cols = (np.arange(values.shape[1]) + offset_px[0]) % self._size[0]
        array[np.ix_(rows, cols)] = values
        return np.asarray(cv2.dft(array), dtype=np.float32)

    def _forward(self, values: Float32Array) -> Float32Array:
        array = np.zeros((self._size[1], self._size[0]), np.float32)
        array[: values.shape[0], : values.shape[1]] = values
        return np.asarray(cv2.dft(array), dtype=np.float32)

    def _inverse(self, spectrum: Float32Array) -> Float32Array:
        return np.asarray(cv2.idft(spectrum, flags=cv2.DFT_SCALE | cv2.DFT_REAL_OUTPUT), dtype=np.float32)


def _product(map_spectrum: Float32Array, template_spectrum: Float32Array) -> Float32Array:
    """Spectrum of the correlation, in OpenCV's packed format."""
    return np.asarray(cv2.mulSpectrums(map_spectrum, template_spectrum, 0, conjB=True), dtype=np.float32)
