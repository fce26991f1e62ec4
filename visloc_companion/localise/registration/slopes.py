"""Where the ground itself slopes as the source's does: a look that is left where nothing that stands is.

Over fields nothing stands out at 8 m but crops, single trees and the borders of parcels, which are others every year; the ground
below rises and falls as before. Its slopes are compared over 6 m, as complex numbers (east + i north), which turn with the
heading: a difference of level is none of slope, a tilt is one value everywhere and a bowl grows with the distance from the
middle, both held by what is known of them. Steep cells (crowns, walls, the borders of crops) count for little, so that the mean
about them is the ground's beside them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from visloc_companion.localise.features.base import Float32Array, Mask
from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.correlation import summits
from visloc_companion.localise.registration.height_map import HeightMap
from visloc_companion.localise.registration.pair import GENTLE_M, Pair
from visloc_companion.localise.registration.refine import SIGMA_BOWL_M, TINY
from visloc_companion.localise.registration.search import APART_M, hypotheses, reach_of, region
from visloc_companion.localise.registration.similarity import moved
from visloc_companion.localise.registration.surfaces import central_slopes
from visloc_companion.localise.spectra import BlockCorrelator, Complex64Array, block_size
from visloc_companion.types import FloatArray

CELL_M = 2.0
"""About the side of the cells that slopes are compared on."""
SPREAD_M = 6.0
"""Sigma of the mean of the slopes."""
GENTLE = 0.15
"""A slope at which a cell counts a quarter (Geman and McClure)."""
LEAST_KNOWN, LEAST_OVERLAP = 0.2, 0.5
"""Share of a mean's weight that a cell must have; of the source's cells that must lie on known ones."""
NOISE = 0.005
"""Slopes of two dates differ by this (1-sigma) where nothing has changed."""
BOWL_SLOPE = 1.5
"""Of a bowl of 1 m, at the distance of half the source's side: over that (surfaces.cells_of)."""


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """(H, W) complex `slope` (east + i north, rise over run; 0 where not `known`) on cells as HeightMap's."""

    slope: Complex64Array
    known: Mask
    corner_m: FloatArray
    cell_m: float


def slopes_of(smooth: HeightMap) -> Slopes:
    """Of a surface, given its means over GENTLE_M."""
    ring = np.ones((3, 3), np.uint8)
    known = cv2.erode(smooth.known.astype(np.float32), ring, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    east, north = central_slopes(smooth)
    weight = known / np.square(1 + (np.square(east) + np.square(north)) / np.float32(GENTLE**2))
    blurred = [_blur(np.asarray(a, np.float32), SPREAD_M / smooth.cell_m) for a in (weight * east, weight * north, weight)]
    enough = blurred[2] > LEAST_KNOWN
    slope = (blurred[0] + 1j * blurred[1]) / np.maximum(blurred[2], np.float32(LEAST_KNOWN)) * enough
    at, corner_m, cell_m = thinned(smooth, CELL_M)
    return Slopes(slope[at].astype(np.complex64), enough[at], corner_m, cell_m)


def thinned(heights: HeightMap, cell_m: float) -> tuple[tuple[slice, slice], FloatArray, float]:
    """Which rows and columns of a map stand for cells of about `cell_m`, and the corner and side of these, metres."""
    step = max(1, round(cell_m / heights.cell_m))
    first = step // 2
    every = slice(first, None, step)
    return (every, every), heights.corner_m + heights.cell_m * (first + 0.5 - 0.5 * step), step * heights.cell_m


def by_chance(area_m2: float, pairs: int) -> float:
    """Logarithm of the number of places in a region, times `pairs` of heading and scale: chance has so many nats in one of as
    many."""
    return math.log(max(area_m2 / (math.pi * APART_M**2), 1.0) * pairs)


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """`nats` (rows, cols): log-likelihood of the slopes at each place of the prior's region, at the best of the `pairs` of
    heading and scale, above that of level ground; 0 where it is less, or too little is known. `origin` (column, row) of the first
    of these among the reference's cells."""

    pair: Pair
    reference: Slopes
    pairs: list[tuple[float, float]]
    nats: Float32Array
    origin: tuple[int, int]

    def at(self, T: FloatArray) -> float:
        """Of the place to which T (4, 4) takes the source."""
        u, v = (int(k) for k in np.rint(self._cells(moved(T, self.pair.centre_m)[:2])))
        near = self.nats[max(v - 1, 0) : max(v + 2, 0), max(u - 1, 0) : max(u + 2, 0)]
        return float(near.max()) if near.size else 0.0

    def lead(self, T: FloatArray) -> float:
        """Of the place to which T (4, 4) takes the source, above the likeliest peak that is another place, or above what the
        likeliest of so many places has by chance."""
        u, v = self._cells(moved(T, self.pair.centre_m)[:2])
        rows, cols = np.nonzero(summits(self.nats))
        away = np.square(rows - v) + np.square(cols - u) >= (APART_M / self.reference.cell_m) ** 2
        return self.at(T) - float(np.max(self.nats[rows, cols], where=away, initial=self._by_chance))

    @property
    def _by_chance(self) -> float:
        return by_chance(self.nats.size * self.reference.cell_m**2, len(self.pairs))

    def _cells(self, xy_m: FloatArray) -> FloatArray:
        cells = (xy_m - self.reference.corner_m) / self.reference.cell_m - 0.5
        return np.asarray(cells - np.array(self.origin), dtype=np.float64)


def ground_of(pair: Pair, prior: RegistrationPrior) -> Ground:
    """Of all places and headings of the prior's."""
    source, reference = (slopes_of(heights) for heights in pair.gentle)
    cell = reference.cell_m
    pairs = hypotheses(pair.half_m, cell, prior)
    ratio, (low, high) = cell / pair.reference.cell_m, region(pair, prior)
    first, last = (np.rint((k - (ratio - 1) / 2) / ratio).astype(int) for k in (low, high))
    if (last < first).any():
        return Ground(pair, reference, pairs, np.zeros((0, 0), np.float32), (0, 0))
    box, reach = (int(first[0]), int(first[1]), int(last[0]), int(last[1])), math.ceil(reach_of(pair, pairs) / ratio)
    extent = (-reach, -reach, reach, reach)
    size = block_size(box, extent, 3, len(pairs))
    fields = reference.known + 1j * np.square(np.abs(reference.slope)), reference.slope
    known, slope = (BlockCorrelator(f.astype(np.complex64)[None], box, extent, size) for f in fields)
    best = np.zeros((box[3] - box[1] + 1, box[2] - box[0] + 1), np.float32)
    for at in pairs:
        of = _turned(source, pair, at, cell, reach)
        terms = (of.known, np.square(np.abs(of.slope)), of.slope, of.bowl)
        spectra = [known.spectrum(t.astype(np.complex64)[None], (-reach, -reach)) for t in terms]
        for block, where in enumerate(known.blocks):
            sums = [by.summed(block, spectra[j]) for by, j in ((known, 0), (known, 1), (slope, 0), (slope, 2), (slope, 3))]
            np.maximum(best[where], _nats(of, sums, cell, prior), out=best[where])
    return Ground(pair, reference, pairs, best, box[:2])


@dataclass(frozen=True, slots=True, eq=False)
class _Turned:
    """(h, w) the source's slopes, turned and scaled about its centre, where `known` (1, else 0), less their `mean` and the `bent`
    by which they have a part in the slopes of a `bowl`: 1 at half the source's side from the middle, on the mean 0."""

    slope: Complex64Array
    known: Float32Array
    bowl: Complex64Array
    mean: complex
    bent: float
    half_m: float


def _turned(source: Slopes, pair: Pair, at: tuple[float, float], cell_m: float, reach: int) -> _Turned:
    yaw, scale = at
    c, s = math.cos(yaw), math.sin(yaw)
    to_source = np.array([[c, s], [-s, c]]) * (cell_m / (scale * source.cell_m))
    middle = (pair.centre_m[:2] - source.corner_m) / source.cell_m - 0.5
    matrix = np.column_stack([to_source, middle - to_source @ np.array([reach, reach])])
    size, flags = (2 * reach + 1, 2 * reach + 1), cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    east, north, weight = (
        cv2.warpAffine(np.ascontiguousarray(a, dtype=np.float32), matrix, size, flags=flags)
        for a in (source.slope.real, source.slope.imag, source.known)
    )
    known = (weight > 0.5).astype(np.float32)
    slope = (east + 1j * north) / np.maximum(weight, np.float32(0.5)) * complex(c, s)
    along = (np.arange(2 * reach + 1, dtype=np.float32) - reach) * np.float32(cell_m / (scale * pair.half_m))
    n = max(float(known.sum()), 1.0)
    out = along + 1j * along[:, None]
    mean = complex((slope * known).sum()) / n
    slope, bowl = (slope - mean) * known, (out - (out * known).sum() / n) * known
    bent = float(np.vdot(bowl, slope).real) / max(float(np.square(np.abs(bowl)).sum()), TINY)
    return _Turned((slope - bent * bowl).astype(np.complex64), known, bowl.astype(np.complex64), mean, bent, scale * pair.half_m)


def _nats(of: _Turned, sums: list[Complex64Array], cell_m: float, prior: RegistrationPrior) -> Float32Array:
    """Log-likelihoods above that of level ground from sum n + i sum n |g|^2, sum n |t|^2, sum n g, sum n t* g and sum n bowl* g;
    0 where too little is known."""
    overlap, of_tt, of_g, of_tg, of_bg = sums
    n, own = np.maximum(overlap.real, np.float32(1)), float(np.square(np.abs(of.slope)).sum())
    of_bb = max(float(np.square(np.abs(of.bowl)).sum()), TINY)
    mean, bent = of_g / n, of_bg.real / np.float32(of_bb)
    rest = overlap.imag - n * np.square(np.abs(mean)) - of_bb * np.square(bent) + of_tt.real - 2 * of_tg.real
    variance, level = np.maximum(rest, 0) / (2 * n) + NOISE**2, own / max(2 * float(of.known.sum()), 1.0) + NOISE**2
    nats = n * (cell_m**2 / (4 * math.pi * (GENTLE_M**2 + SPREAD_M**2))) * np.log(level / variance)
    nats -= np.square(np.abs(mean - of.mean)) / (2 * max(prior.sigma_tilt_rad, NOISE) ** 2)
    nats -= np.square(bent - of.bent) / (2 * (BOWL_SLOPE * SIGMA_BOWL_M / of.half_m) ** 2)
    nats[overlap.real < LEAST_OVERLAP * of.known.sum()] = 0
    return np.asarray(nats, dtype=np.float32)


def _blur(values: Float32Array, sigma_cells: float) -> Float32Array:
    return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma_cells, borderType=cv2.BORDER_CONSTANT), dtype=np.float32)
