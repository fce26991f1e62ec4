"""Log-likelihood of every position and height offset at once, by FFT.

The log density f of one height difference (noise.py) is a Fourier series over PERIOD_M; for soundings of height z at places x,

    sum_x f(z(x) - M(x + s) - b) = Re sum_k c_k exp(-i w_k b) sum_x exp(i w_k z(x)) exp(-i w_k M(x + s)),

so that a robust, one-sided matching cost is K ordinary correlations of unit phasors (localise/spectra.py), and every vertical
offset b costs one inverse transform. A mean-removed squared difference is the same with a parabola for f; the parabola follows
crowns, this does not. Unknown cells of the model contribute nothing, and f is taken less its mean for the right place, so that
covering less of the model is no advantage. Time is (K + B) A log A for A cells and B offsets, memory 8 K A bytes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.search import NO_SCORE, ScoreVolume
from visloc_companion.localise.spectra import BlockCorrelator, Box, Complex64Array, block_size
from visloc_companion.localise.terrain.elevation import Terrain
from visloc_companion.localise.terrain.noise import HeightNoise, expected_log_density, parts
from visloc_companion.types import FloatArray, Vec2

PERIOD_M = 160.0
SAMPLES = 1024
SHARPNESS = 2.6
"""Harmonics up to this many radians a sigma: beyond, the density has next to nothing."""
MIN_KNOWN = 0.6
"""Share of the soundings that must lie on known cells."""
MISSING = -1e4
OFFSET_STEP_SIGMAS = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """Soundings under one hypothesis of heading and drift: (N, 2) north, east and (N,) height, relative to the position."""

    ne_m: FloatArray
    height_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Volume:
    """`scores`: tempered log-likelihood (u to the east, v to the north, cells of the window) at the best offset, less half its
    squared sigmas from the prior height; `offset_m` that offset (measured less model). NO_SCORE is below all."""

    scores: ScoreVolume
    offset_m: Float32Array


def search(
    terrain: Terrain,
    stretches: Sequence[Stretch],
    noise: HeightNoise,
    centre_ne_m: Vec2,
    reach_m: Vec2,
    sigma_offset_m: float,
    temper: float,
) -> Volume:
    """The volume over positions within `reach_m` (north, east) of a centre; `temper` is the share of soundings that count as
    independent."""
    at = (np.array(centre_ne_m) - terrain.first_ne_m) / terrain.cell_m
    half = [math.ceil(r / terrain.cell_m) for r in reach_m]
    v, u = round(at[0]), round(at[1])
    box: Box = (u - half[1], v - half[0], u + half[1], v + half[0])
    cells = [np.rint(s.ne_m / terrain.cell_m).astype(np.int64) for s in stretches]
    low, high = np.min([c.min(0) for c in cells], 0), np.max([c.max(0) for c in cells], 0)
    extent: Box = (int(low[1]), int(low[0]), int(high[1]), int(high[0]))
    coefficients, omega = _series(noise)
    offsets = _offsets(noise, sigma_offset_m)
    size = block_size(box, extent, 1, len(stretches) * len(offsets))
    level = float(np.median(terrain.height_amsl_m[terrain.known])) if terrain.known.any() else 0.0
    fields = BlockCorrelator(_fields(terrain, level, coefficients, omega), box, extent, size)
    counts = BlockCorrelator(terrain.known[None].astype(np.complex64), box, extent, size)
    best = np.full((2 * half[0] + 1, 2 * half[1] + 1), MISSING, np.float32)
    which, offset = np.zeros(best.shape, np.int32), np.zeros(best.shape, np.float32)
    for k, (stretch, at_cells) in enumerate(zip(stretches, cells, strict=True)):
        template, corner = _template(at_cells, stretch.height_m - level, omega)
        spectrum = fields.spectrum(template, corner)
        of_count = counts.spectrum(template[:1].real.astype(np.complex64), corner)
        for block, where in enumerate(fields.blocks):
            enough = counts.each(block, of_count)[0].real >= MIN_KNOWN * len(stretch.height_m)
            for b in offsets:
                turned = spectrum * np.exp(1j * omega * b).astype(np.complex64)[:, None, None]
                value = np.float32(temper) * fields.summed(block, turned).real - np.float32(0.5 * (b / sigma_offset_m) ** 2)
                better = enough & (value > best[where])
                np.copyto(best[where], value, where=better)
                np.copyto(which[where], np.int32(k), where=better)
                np.copyto(offset[where], np.float32(b), where=better)
    return Volume(ScoreVolume(_as_scores(best), which, (box[0], box[1])), offset)


def _as_scores(best: Float32Array) -> Float32Array:
    """Shifted so that the best is zero and all with a score stay above NO_SCORE (scores are compared, never read)."""
    missing = best <= MISSING
    if missing.all():
        return np.full(best.shape, NO_SCORE, np.float32)
    shifted = best - best[~missing].min() + 1
    return np.where(missing, np.float32(NO_SCORE), shifted)


def _offsets(noise: HeightNoise, sigma_offset_m: float) -> FloatArray:
    step = OFFSET_STEP_SIGMAS * noise.sigma_m
    n = min(math.ceil(3 * sigma_offset_m / step), math.floor(PERIOD_M / 3 / step))
    return np.asarray(np.arange(-n, n + 1) * step, dtype=np.float64)


def _series(noise: HeightNoise) -> tuple[NDArray[np.complex128], FloatArray]:
    """Conjugate coefficients (K,) complex and angular frequencies (K,), rad/m."""
    at = (np.arange(SAMPLES) / SAMPLES - 0.5) * PERIOD_M
    values = parts(noise, at).log_density - expected_log_density(noise)
    n = min(SAMPLES // 4, math.ceil(SHARPNESS / noise.sigma_m * PERIOD_M / (2 * math.pi)) + 1)
    omega = 2 * math.pi * np.arange(n) / PERIOD_M
    mean = np.exp(-1j * omega[:, None] * at[None]) @ values / SAMPLES
    mean[1:] *= 2
    return np.conj(mean), np.asarray(omega, dtype=np.float64)


def _fields(terrain: Terrain, level: float, coefficients: NDArray[np.complex128], omega: FloatArray) -> Complex64Array:
    """(K, R, C) of conj(c_k) exp(i w_k M), zero where the model is unknown."""
    height = np.where(terrain.known, terrain.height_amsl_m - np.float32(level), 0).astype(np.float64)
    step = np.exp(1j * omega[1] * height).astype(np.complex64) if len(omega) > 1 else np.ones(height.shape, np.complex64)
    fields = np.empty((len(omega), *height.shape), np.complex64)
    fields[0] = terrain.known
    for k in range(1, len(omega)):
        np.multiply(fields[k - 1], step, out=fields[k])
    fields *= coefficients.astype(np.complex64)[:, None, None]
    return fields


def _template(
    cells: np.ndarray[tuple[int, int], np.dtype[np.int64]], height: FloatArray, omega: FloatArray
) -> tuple[Complex64Array, tuple[int, int]]:
    """(K, h, w) sums of exp(i w_k z) over the soundings of each cell, and (u, v) of its first cell from the position."""
    low = cells.min(0)
    rows, cols = cells.max(0) - low + 1
    key = (cells[:, 0] - low[0]) * cols + cells[:, 1] - low[1]
    template = np.empty((len(omega), rows * cols), np.complex64)
    for k, w in enumerate(omega):
        template[k].real = np.bincount(key, np.cos(w * height), rows * cols)
        template[k].imag = np.bincount(key, np.sin(w * height), rows * cols)
    return template.reshape(len(omega), rows, cols), (int(low[1]), int(low[0]))
