"""What soundings tell where the model's errors are alike nearby: generalised least squares (Aitken 1935).

Soundings that count alike leave all long waves of the model's errors in the position. With the covariance of their weighted means
over the cells of cells.py

    C = errors of the model, alike as in correlation.py  +  its errors of the cell alone  +  noise of the soundings / weight
        +  what the navigation height walked since

a level that is off over hundreds of metres tells little, and what the ground does within them tells the more. Of what soundings
differ by within a cell a model with cells as large says nothing: there its errors have slopes that would be taken for ground.

The navigation height is known when the stretch ends and walks the further the longer before: in C the newest soundings tell the
height, and what it walked is no slope of the ground.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve  # type: ignore[import-untyped]

from visloc_companion.localise.terrain.cells import Cells
from visloc_companion.types import FloatArray

LEAST_GROUND = 1e-9
"""Probability of being ground that every sounding keeps (a finite covariance)."""


@dataclass(frozen=True, slots=True, eq=False)
class Walk:
    """Of the navigation height, back from now: a random walk of `m2_per_s`; and the ages (N,) of the soundings, seconds."""

    age_s: FloatArray
    m2_per_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Whitening:
    """`factor` (M, M), lower, of the covariance of measured minus model in the mean of each cell; `share` (N,) of each sounding
    in its cell's mean; `cell_m2`: variance that is each cell's own."""

    factor: FloatArray
    cells: Cells
    share: FloatArray
    cell_m2: float

    def solved(self, values: FloatArray) -> FloatArray:
        """(N,) or (N, K): the inverse covariance times the cells' means of values, by the sounding: what values times this sum up
        to is the product of both means under the covariance."""
        wide = values.reshape(len(values), -1)
        mean = self.cells.sums(self.share[:, None] * wide)
        inverse = self.share[:, None] * cho_solve((self.factor, True), mean)[self.cells.of]
        return np.asarray(inverse.reshape(values.shape), dtype=np.float64)

    def told(self, J: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Information (K, K) of (N, K) derivatives; and the covariance of the gradient if what was taken for the cells' own is
        alike nearby as well: over hundreds of cells it would average out, and nobody knows how much of it does."""
        mean = self.cells.sums(self.share[:, None] * J)
        inverse = cho_solve((self.factor, True), mean)
        information = mean.T @ inverse
        alike = inverse.T @ self.cells.alike @ inverse
        return information, information + self.cell_m2 * (alike - inverse.T @ inverse)


def whitening(
    cells: Cells, alike_m2: float, cell_m2: float, own_m2: float, walk: Walk, ground: FloatArray, known: NDArray[np.bool_]
) -> Whitening:
    """For errors of the model of a variance `alike_m2` that are alike as in `cells` and of `cell_m2` that are each cell's own,
    soundings with a variance `own_m2` > 0 of their own under a height that walks, their probabilities of being ground (N,), and
    whether they lie on known model (N,)."""
    weight = np.maximum(ground * known, LEAST_GROUND)
    of_cell = cells.sums(weight)
    share = weight / of_cell[cells.of]
    age_s = cells.sums(share * walk.age_s)
    covariance = alike_m2 * cells.alike + np.diag(cell_m2 / np.minimum(of_cell, 1.0) + own_m2 / of_cell)
    covariance += walk.m2_per_s * np.minimum(age_s[:, None], age_s[None])
    return Whitening(np.asarray(cho_factor(covariance, lower=True)[0], dtype=np.float64), cells, share, cell_m2)
