"""Which ground has stayed as the reference knows it, near a place that was found, and where that ground would have the source.

Where land was felled, built or ploughed since, differences of height are no noise: they are alike over a crown, a house or a
parcel, and a step that takes them for measurements follows whichever objects it can push over a border. A block of ground that
has changed shows itself by its relief, which resembles the reference's nowhere near; one that has not resembles it at one shift,
and the blocks that have not changed name the same shift. So the likeliest shift is that of

    sum over blocks of -n log(1 - c²) / 2

with the correlation c of a block's n cells: the likelihood of a block whose level, gain and noise are its own. A block without
resemblance says nothing, however much it differs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.parabola import peak_offset
from visloc_companion.localise.registration.search import APART_M
from visloc_companion.localise.registration.similarity import moved
from visloc_companion.localise.registration.surfaces import IN_REFERENCE, SourceCells, Surface
from visloc_companion.types import FloatArray

BLOCK_M = 16.0
"""A few crowns or a house to a block. With 12 and 20 m errors are the same, with 28 and 40 m they are larger."""
NOISE_M = 0.1
"""Relief below this is noise, whatever it resembles."""
MOST = 0.98
"""No more correlation than this is told from a better one."""
LEAST_TRUST = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Consensus:
    """`shift_m` (2,) east and north of the reference, to where the blocks agree best; `trust` (N,) of the source's cells, above 0
    and at most 1: how far their relief tells where it lies."""

    shift_m: FloatArray
    trust: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Beside:
    """(V, U) `nats`: the likelihood of a place and of those beside it, as if a block's cells were independent; (V, U, 2) `at_m`:
    how far these are, east and north of the reference."""

    nats: FloatArray
    at_m: FloatArray


def consensus(source: SourceCells, relief: Surface, T: FloatArray, reach_m: float = APART_M) -> Consensus:
    """What the source's blocks say of the reference's relief up to `reach_m` about where T (4, 4) puts them."""
    laid = _laid(source, relief, T, math.ceil(reach_m / relief.heights.cell_m))
    score = laid.nats()
    if score.max() <= 0:  # nothing resembles anything, as on a level
        score[laid.margin, laid.margin] = 1
    v, u = divmod(int(np.argmax(score)), laid.wide)
    right, down = peak_offset(score, v, u)
    cells = np.array([u + right, v + down]) - laid.margin
    trust = laid.shifted(v, u).trust().reshape([n // laid.side for n in laid.own.shape])
    trust = trust[source.rows // laid.side, source.cols // laid.side]
    shift_m = T[:2, :2] @ (cells * relief.heights.cell_m)
    return Consensus(shift_m, np.maximum(trust / max(float(trust.max()), 1e-12), LEAST_TRUST))


def beside(source: SourceCells, relief: Surface, T: FloatArray, reach_m: float = APART_M, step: int = 1) -> Beside:
    """How likely the source's blocks make where T (4, 4) puts them, and what is up to `reach_m` beside on either axis, every so
    many cells."""
    laid = _laid(source, relief, T, math.ceil(reach_m / (step * relief.heights.cell_m)) * step)
    along = range(0, laid.wide, step)
    nats = np.array([[laid.shifted(v, u).nats() for u in along] for v in along])
    u, v = np.meshgrid(*[(np.array(along) - laid.margin) * relief.heights.cell_m] * 2)
    return Beside(nats, np.asarray(np.stack([u, v], -1) @ T[:2, :2].T, dtype=np.float64))


@dataclass(frozen=True, slots=True, eq=False)
class _Laid:
    """The source's relief (rows, cols) in whole blocks of `side` cells, which of it is `known`, and the reference's on these
    cells with `margin` more on each side, and where that is known."""

    own: Float32Array
    known: Float32Array
    beside: Float32Array
    there: Float32Array
    side: int
    margin: int

    @property
    def wide(self) -> int:
        """Shifts on an axis."""
        return 2 * self.margin + 1

    def shifted(self, v: int, u: int) -> _Blocks:
        """The blocks at a shift; (margin, margin) is none."""
        rows, cols = self.own.shape
        window = (slice(v, v + rows), slice(u, u + cols))
        of_block = _of_block(rows, self.side), _of_block(cols, self.side)
        return _compared(self.own, self.beside[window], self.known * self.there[window], of_block)

    def nats(self) -> FloatArray:
        """(wide, wide) likelihood of every shift."""
        return np.array([[self.shifted(v, u).nats() for u in range(self.wide)] for v in range(self.wide)])


def _laid(source: SourceCells, relief: Surface, T: FloatArray, margin: int) -> _Laid:
    cell = relief.heights.cell_m
    side = max(4, round(BLOCK_M / cell))
    rows, cols = (-(-n // side) * side for n in source.shape)
    known, own = np.zeros((2, rows, cols), np.float32)
    known[source.rows, source.cols], own[source.rows, source.cols] = 1, source.relief_m
    return _Laid(own, known, *_beside(source, relief, T, (rows, cols), margin), side, margin)


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """(B,) number of cells that are known in both, correlation (0 where it is negative) and the source's variance."""

    number: FloatArray
    correlation: FloatArray
    variance: FloatArray

    def nats(self) -> float:
        """Likelihood of the shift."""
        return -0.5 * float(self.number @ np.log(1 - np.square(self.correlation)))

    def trust(self) -> FloatArray:
        """(B,) the inverse of the variance that the reference leaves, of those that resemble it."""
        left = self.variance * (1 - np.square(self.correlation)) + NOISE_M**2
        return np.asarray(np.square(self.correlation) / left, dtype=np.float64)


def _beside(
    source: SourceCells, relief: Surface, T: FloatArray, shape: tuple[int, int], margin: int
) -> tuple[Float32Array, Float32Array]:
    """The reference's relief on the source's cells, so many more on each side, and where it is known (1, else 0)."""
    cell = relief.heights.cell_m
    rows, cols = (np.arange(-margin, n + margin) for n in shape)
    corner = source.points_m[0] - cell * np.array([source.cols[0], source.rows[0], 0])
    grid = np.stack(np.broadcast_arrays(cols * cell, rows[:, None] * cell, 0.0), -1).reshape(-1, 3)
    grid += [corner[0], corner[1], float(source.points_m[:, 2].mean())]
    layers = relief.at(moved(T, grid)[:, :2]).reshape(len(rows), len(cols), -1)
    return np.asarray(layers[..., 0], dtype=np.float32), np.asarray(layers[..., 3] > IN_REFERENCE, dtype=np.float32)


def _of_block(cells: int, side: int) -> Float32Array:
    """(cells, blocks) 1 where a cell lies in a block, on one axis."""
    return np.repeat(np.eye(cells // side, dtype=np.float32), side, 0)


def _compared(
    own: Float32Array, beside: Float32Array, both: Float32Array, of_block: tuple[Float32Array, Float32Array]
) -> _Blocks:
    rows, cols = of_block
    a, b = own * both, beside * both
    sums = (rows.T @ np.stack([both, a, b, a * a, b * b, a * b]) @ cols).astype(np.float64)
    number, *of = sums.reshape(6, -1)
    mean_a, mean_b, square_a, square_b, product = np.stack(of) / np.maximum(number, 1)
    var_a, var_b = np.maximum(square_a - mean_a**2, 0), np.maximum(square_b - mean_b**2, 0)
    c = (product - mean_a * mean_b) / np.sqrt((var_a + NOISE_M**2) * (var_b + NOISE_M**2))
    return _Blocks(number, np.clip(c, 0, MOST), var_a)
