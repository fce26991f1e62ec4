"""Where the ground that has not changed slopes and lies as the source's does: asked where a place is doubtful.

Slopes of two dates differ by little where nothing has changed and are any that occur where something has. So a cell is a mixture
of the two, and its log-likelihood is stated over that of slopes as they occur on the reference:

    log( (1 - CHANGED) N(source's - reference's) + CHANGED usual(source's) ) - log usual(source's)

What was felled, sown or built costs its own cells and does not bend what is thought of the others, and level cells, of which
there are many, tell little where they are alike. Tilt and bowl are solved for with each place, held by what is known of them, and
so is the height, by the cells that are alike. First all places are looked at roughly, by few cells; the best are compared whole.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.base import Float32Array, Mask
from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.height_map import HeightMap
from visloc_companion.localise.registration.pair import GENTLE_M, Pair
from visloc_companion.localise.registration.refine import SIGMA_BOWL_M
from visloc_companion.localise.registration.search import APART_M, hypotheses, region
from visloc_companion.localise.registration.similarity import about, moved, scale_of, yaw_of
from visloc_companion.localise.registration.slopes import BOWL_SLOPE, by_chance, thinned
from visloc_companion.localise.registration.surfaces import central_slopes, looked_up
from visloc_companion.localise.spectra import Complex64Array
from visloc_companion.types import FloatArray

CELL_M, STEP_M = 2.0, 4.0
"""About the side of the cells of slopes; about how far apart those of the source are that are compared, and places."""
ALIKE, CHANGED = 0.007, 0.5
"""1-sigma on each axis by which slopes differ where nothing has changed; share of the cells where something has."""
GROWTH_M, MOST_FAR = 1.0, 15.0
"""Heights of fields differ by this beside the prior's (1-sigma); nats that a height far from it costs at most."""
ROUGHLY, EVERY = 0.03, 3
"""The first look takes slopes for alike that differ by about this, and every third cell each way."""
RIVALS = 8
"""So many of the likeliest places are others that a place has to lead."""
COMPARED, ROUNDS = 600, 5
"""So many places of the first look are compared whole, with so many rounds for tilt and bowl."""
LEAST_KNOWN, LEAST_OVERLAP = 0.9, 0.5
LEAST_TILT = 0.005
UNKNOWN = 1e3
"""A slope unlike any."""
USUAL_FROM, USUAL_TO, USUAL_BINS = 0.004, 2.0, 26


@dataclass(frozen=True, slots=True, eq=False)
class Lie:
    """(H, W) complex `slope` (east + i north, rise over run; 0 where not `known`) and `height_m` on cells as HeightMap's."""

    slope: Complex64Array
    height_m: Float32Array
    known: Mask
    corner_m: FloatArray
    cell_m: float

    def cells_of(self, xy_m: FloatArray) -> FloatArray:
        """As HeightMap's."""
        return np.asarray((xy_m - self.corner_m) / self.cell_m - 0.5, dtype=np.float64)

    def at(self, xy_m: FloatArray) -> tuple[Complex64Array, Float32Array, Mask]:
        """(N,) slopes and heights at places (N, 2), and which are known."""
        layers = np.stack([self.slope.real, self.slope.imag, self.height_m, self.known], -1).astype(np.float32)
        east, north, height, known = looked_up(layers, self.cells_of(xy_m), cv2.INTER_LINEAR).T
        return (east + 1j * north).astype(np.complex64), np.ascontiguousarray(height), np.asarray(known > LEAST_KNOWN)


def lie_of(smooth: HeightMap) -> Lie:
    """Of a surface, given its means over GENTLE_M."""
    ring = np.ones((3, 3), np.uint8)
    inner = cv2.erode(smooth.known.astype(np.uint8), ring, borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    east, north = central_slopes(smooth)
    slope = np.asarray((east + 1j * north) * inner, dtype=np.complex64)
    at, corner_m, cell_m = thinned(smooth, CELL_M)
    return Lie(slope[at], smooth.height_m[at], np.asarray(inner[at]), corner_m, cell_m)


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """(N, 2) east and north to which the source's middle is taken, (N,) headings, radians, and scales."""

    xy_m: FloatArray
    yaw_rad: FloatArray
    scale: FloatArray

    def some(self, which: NDArray[np.intp]) -> Places:
        """Of these, in this order."""
        return Places(self.xy_m[which], self.yaw_rad[which], self.scale[which])


class Lasting:
    """Nats by which the lie of the source's ground is likelier at a place than that of any ground of the reference."""

    def __init__(self, pair: Pair, prior: RegistrationPrior) -> None:
        self._pair, self._prior = pair, prior
        source, self._reference = (lie_of(heights) for heights in pair.gentle)
        along = np.arange(-pair.half_m + STEP_M / 2, pair.half_m, STEP_M)
        off = np.stack(np.meshgrid(along, along), -1).reshape(-1, 2)
        slope, height, known = source.at(off + pair.centre_m[:2])
        self._off, self._slope, self._height_m = off[known] @ np.array([1, 1j]), slope[known], height[known] - pair.centre_m[2]
        few = np.zeros((len(along), len(along)), np.bool_)
        few[EVERY // 2 :: EVERY, EVERY // 2 :: EVERY] = True
        self._few = few.ravel()[known]
        self._usual = _usual(self._reference, self._slope)
        pairs = hypotheses(pair.half_m, self._reference.cell_m, prior)
        low, high = region(pair, prior)
        self._by_chance = by_chance(float(np.prod(np.maximum(high - low + 1, 0))) * pair.reference.cell_m**2, len(pairs))
        looked_at = self._first_look(pairs, low, high)
        nats = self.nats(looked_at)
        order = np.argsort(-nats, kind="stable")
        self._places, self._found = looked_at.some(order), nats[order]

    @property
    def most(self) -> float:
        """Of the likeliest place; 0 where nothing is known."""
        return max(float(self._found.max(initial=0.0)), 0.0)

    def at(self, T: FloatArray) -> float:
        """Of the place to which T (4, 4) takes the source, or the likeliest so near; 0 where too little is known."""
        return max(float(self.nats(self._about(T, (0.0,))).max()), 0.0)

    def lead(self, T: FloatArray, others: Iterable[FloatArray] = ()) -> float:
        """Of the place to which T (4, 4) takes the source, above the likeliest that is another place, or above what the likeliest
        of so many places has by chance. Compared are those of `others` and the likeliest places, each at its best nearby."""
        here, rival = moved(T, self._pair.centre_m)[:2], self._by_chance
        for other in (*others, *self.starts(RIVALS)):
            near = self._near(other)
            away = np.hypot(*(near.xy_m - here).T) >= APART_M
            if away.any():
                rival = max(rival, float(self.nats(near.some(np.nonzero(away)[0])).max()))
        return float(self.nats(self._near(T)).max()) - rival

    def starts(self, most: int) -> list[FloatArray]:
        """(4, 4) The likeliest places."""
        found: list[FloatArray] = []
        left = self._found > 0
        while len(found) < most and left.any():
            k = int(np.argmax(left))
            found.append(self._similarity(self._places, k))
            left &= np.hypot(*(self._places.xy_m - self._places.xy_m[k]).T) >= APART_M
        return found

    def placed(self, T: FloatArray) -> FloatArray:
        """(4, 4) The likeliest similarity near T, which lies within a step of it in place and heading."""
        near = self._near(T)
        return self._similarity(near, int(np.argmax(self.nats(near))))

    def _near(self, T: FloatArray) -> Places:
        """Places within half a step of that of T (4, 4), and headings."""
        turn = STEP_M / self._pair.half_m
        return self._about(T, (-turn / 2, -turn / 4, 0.0, turn / 4, turn / 2))

    def _about(self, T: FloatArray, turns_rad: tuple[float, ...]) -> Places:
        side = np.linspace(-STEP_M / 2, STEP_M / 2, 5)
        east, north, turn = (a.ravel() for a in np.meshgrid(side, side, turns_rad))
        here = moved(T, self._pair.centre_m)[:2]
        return Places(here + np.column_stack([east, north]), yaw_of(T) + turn, np.full(len(turn), scale_of(T)))

    def _similarity(self, of: Places, k: int) -> FloatArray:
        shift = np.append(of.xy_m[k] - self._pair.centre_m[:2], 0.0)
        return about(self._pair.centre_m, float(of.yaw_rad[k]), float(of.scale[k]), shift)

    def _first_look(self, pairs: list[tuple[float, float]], low: NDArray[np.int_], high: NDArray[np.int_]) -> Places:
        """The best places of the prior's region, each at its best heading and scale, by a few cells."""
        of, pair = self._reference, self._pair
        low_m, high_m = (pair.reference.corner_m + pair.reference.cell_m * (k + 0.5) for k in (low, high))
        first, last = np.ceil(of.cells_of(low_m)).astype(int), np.floor(of.cells_of(high_m)).astype(int)
        step = max(1, round(STEP_M / of.cell_m))
        n, off, slope = (last - first) // step + 1, self._off[self._few], self._slope[self._few]
        if (high < low).any() or (n < 1).any() or not len(off):
            return Places(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
        reach = int(np.abs(off).max() * max(scale for _, scale in pairs) / of.cell_m) + 2
        field, before = _padded(of, first - reach, last + step + reach)
        best, which = np.zeros((n[1], n[0]), np.float32), np.zeros((n[1], n[0]), np.int32)
        for k, (yaw, scale) in enumerate(pairs):
            turn = np.complex64(np.exp(1j * yaw))
            to = off * (scale * turn / of.cell_m)
            u, v = (np.rint(a).astype(int) + first[j] + before[j] for j, a in enumerate((to.real, to.imag)))
            alike = np.zeros(best.shape, np.float32)
            for right, down, own in zip(u, v, slope * turn, strict=True):
                differ = field[down : down + n[1] * step : step, right : right + n[0] * step : step] - own
                square = np.square(differ.real) + np.square(differ.imag)
                alike += np.reciprocal(np.square(1 + square * np.float32(ROUGHLY**-2)))
            better = alike > best
            np.copyto(best, alike, where=better)
            np.copyto(which, np.int32(k), where=better)
        some = np.argpartition(-best.ravel(), min(COMPARED, best.size) - 1)[:COMPARED]
        cells = np.column_stack(np.unravel_index(some, best.shape))[:, ::-1] * step + first
        turns = np.array(pairs)[which.ravel()[some]]
        return Places(of.corner_m + of.cell_m * (cells + 0.5), turns[:, 0], turns[:, 1])

    def nats(self, of: Places) -> FloatArray:
        """(N,) of places; 0 where too little is known."""
        if not len(of.xy_m) or not len(self._off):
            return np.zeros(len(of.xy_m))
        turn = np.exp(1j * of.yaw_rad)[:, None]
        out = self._off * turn * of.scale[:, None]
        at = np.stack([of.xy_m[:, :1] + out.real, of.xy_m[:, 1:] + out.imag], -1)
        slope, height, known = (a.reshape(out.shape) for a in self._reference.at(at.reshape(-1, 2)))
        differ, arm = slope - self._slope * turn, out / self._pair.half_m
        tilt, bowl = np.zeros(len(out), np.complex128), np.zeros(len(out))
        tilt_2, bowl_2 = max(self._prior.sigma_tilt_rad, LEAST_TILT) ** 2, (BOWL_SLOPE * SIGMA_BOWL_M / self._pair.half_m) ** 2
        share = STEP_M**2 / (4 * math.pi * GENTLE_M**2)  # what a cell tells that its neighbours do not
        for left in range(ROUNDS, -1, -1):
            square = np.square(np.abs(differ - tilt[:, None] - bowl[:, None] * arm))
            alike = math.log((1 - CHANGED) / (2 * math.pi * ALIKE**2)) - square / (2 * ALIKE**2)
            either = np.logaddexp(alike, math.log(CHANGED) + self._usual)
            weight = np.exp(alike - either) * known * (share / ALIKE**2)
            if left:
                tilt, bowl = _held(differ, arm, weight, 1 / tilt_2, 1 / bowl_2)
        nats = share * ((either - self._usual) * known).sum(1)
        nats -= np.square(np.abs(tilt)) / (2 * tilt_2) + np.square(bowl) / (2 * bowl_2)
        rise = height - self._pair.centre_m[2] - self._height_m * of.scale[:, None] - (np.conj(tilt)[:, None] * out).real
        up = (weight * rise).sum(1) / np.maximum(weight.sum(1), 1e-9)
        nats -= np.minimum(np.square(up) / (2 * (self._prior.sigma_vertical_m**2 + GROWTH_M**2)), MOST_FAR)
        return np.where(known.mean(1) < LEAST_OVERLAP, 0.0, nats)


def _usual(reference: Lie, slope: Complex64Array) -> FloatArray:
    """(N,) logarithm of how often such slopes (N,) occur, whatever their direction: a density over east and north."""
    edges = np.append(0.0, np.geomspace(USUAL_FROM, USUAL_TO, USUAL_BINS))
    count = np.histogram(np.minimum(np.abs(reference.slope[reference.known]), USUAL_TO), edges)[0] + 1.0
    density = np.log(count / count.sum() / (math.pi * np.diff(np.square(edges))))
    middle = np.sqrt(np.maximum(edges[:-1], USUAL_FROM / 2) * edges[1:])
    usual = np.interp(np.log(np.maximum(np.abs(slope), USUAL_FROM / 2)), np.log(middle), density)
    return np.asarray(usual, dtype=np.float64)


def _padded(of: Lie, low: NDArray[np.int_], high: NDArray[np.int_]) -> tuple[Complex64Array, NDArray[np.int_]]:
    """The slopes on cells (column, row) from `low` to `high` at least, unlike any where not known; how many columns and rows are
    before the first."""
    rows, cols = of.known.shape
    before, after = np.maximum(-low, 0), np.maximum(high + 1 - np.array([cols, rows]), 0)
    field = np.where(of.known, of.slope, np.complex64(UNKNOWN))
    wide = ((int(before[1]), int(after[1])), (int(before[0]), int(after[0])))
    return np.asarray(np.pad(field, wide, constant_values=UNKNOWN), dtype=np.complex64), before


def _held(
    differ: NDArray[np.complex128], arm: NDArray[np.complex128], weight: FloatArray, of_tilt: float, of_bowl: float
) -> tuple[NDArray[np.complex128], FloatArray]:
    """(N,) complex tilt and bowl that the differences of slopes (N, K) are best explained by, each held to 0 by a precision."""
    n, moment = weight.sum(1) + of_tilt, (weight * arm).sum(1)
    inertia = (weight * np.square(np.abs(arm))).sum(1) + of_bowl
    pull, turn = (weight * differ).sum(1), (weight * (np.conj(arm) * differ)).sum(1).real
    bowl = (turn - (np.conj(moment) * pull).real / n) / (inertia - np.square(np.abs(moment)) / n)
    return (pull - bowl * moment) / n, np.asarray(bowl, dtype=np.float64)
