"""What soundings of a line tell where the model's errors are alike nearby: generalised least squares (Aitken 1935).

Soundings that count alike leave all long waves of the model's errors in the position. With their covariance

    C = errors of the model, alike as in correlation.py  +  noise of the soundings / probability that they are ground

a level that is off over hundreds of metres tells little, and what the ground does within them tells the more. A line is short
enough for C in full.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve  # type: ignore[import-untyped]

from visloc_companion.types import FloatArray

LEAST_GROUND = 1e-9
"""Probability of being ground that every sounding keeps (a finite covariance)."""


@dataclass(frozen=True, slots=True, eq=False)
class Whitening:
    """`factor` (N, N), lower, of the covariance of measured minus model."""

    factor: FloatArray

    def solved(self, values: FloatArray) -> FloatArray:
        """(N,) or (N, K): the inverse covariance times values."""
        return np.asarray(cho_solve((self.factor, True), values), dtype=np.float64)


def whitening(alike: FloatArray, alike_m2: float, own_m2: float, ground: FloatArray, known: NDArray[np.bool_]) -> Whitening:
    """For errors of the model of a variance `alike_m2` with correlation (N, N), soundings with a variance `own_m2` > 0 of their
    own, their probabilities of being ground (N,), and whether they lie on known model (N,)."""
    weight = np.maximum(ground * known, LEAST_GROUND)
    covariance = alike_m2 * alike + np.diag(own_m2 / weight)
    return Whitening(np.asarray(cho_factor(covariance, lower=True)[0], dtype=np.float64))
