"""How smoothly frame and map are bent against each other, from what the blocks leave over; and what that may move the pose by.

Two dates of a place are never registered everywhere alike: surface models differ, strips of pictures are sewn together, trees
lean. Such a field of displacements varies slowly, so it does not average down over the blocks of a frame, and most of it goes
into the pose unseen. What the pose cannot follow, a shear, a stretch along one axis, a bend, stays in the blocks' residuals and
tells how large the rest may be.

The residuals are taken for a Gaussian field that is correlated over the side of the footprint, less its part that a shift, turn
and scale explain, plus noise of each block's own. Displacements are complex numbers, north + i east: shift, turn and scale are
then linear, and one Hermitian eigenproblem serves all amplitudes (Lippert et al. 2011, "FaST linear mixed models").
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from visloc_companion.types import FloatArray

MIN_BLOCKS = 6
USUAL_PX = 0.05
"""Scale of the prior of the field's 1-sigma on each axis (Student's t of two degrees of freedom): most pairs are bent by little.
With four times as much, noise of NAIP training blocks was taken for a bend."""
FIELD_PX = np.sqrt([0, 0.003, 0.01, 0.03, 0.1, 0.2, 0.4, 0.7, 1.0, 1.5, 2.2, 3.3, 5.0, 10.0])
NOISE_PX = np.sqrt(np.geomspace(0.02, 30.0, 16))
"""1-sigma of field and noise that are tried; the noise's logarithm may be anything."""
LEAST_WEIGHT = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class GroundErrors:
    """What the blocks of a pose leave over: their places (N, 2) north, east; by how much what the frame shows there is off the
    map (N, 2) metres north, east; and by how much (6, N, 2) the pose moves where the map is off by a metre at one of them."""

    at_ne_m: FloatArray
    apart_ne_m: FloatArray
    moves: FloatArray


def warp_covariance(errors: GroundErrors, weights: FloatArray, gsd_m: float) -> FloatArray:
    """(6, 6) of what a smooth field of displacements adds to a pose's covariance; zero with less than MIN_BLOCKS blocks.

    `weights` (N,) are those of the pose's correspondences, `gsd_m` is the resolution that they were matched at.
    """
    if len(weights) < MIN_BLOCKS:
        return np.zeros((6, 6))
    kernel, at = _kernel(errors.at_ne_m)
    variance_m2 = field_variance(errors.apart_ne_m / gsd_m, at, kernel, weights) * gsd_m**2
    moved = np.einsum("imk,mn,jnk->ij", errors.moves, kernel, errors.moves)
    return np.asarray(variance_m2 * moved, dtype=np.float64)


def field_variance(apart_px: FloatArray, at: NDArray[np.complex128], kernel: FloatArray, weights: FloatArray) -> float:
    """Expected variance (px², an axis) of the field, from residuals (N, 2) at places (N,) with a kernel (N, N)."""
    root = np.sqrt(np.maximum(weights, LEAST_WEIGHT))
    explained, _ = np.linalg.qr(root[:, None] * np.column_stack([np.ones_like(at), at]))
    left = np.eye(len(at)) - explained @ explained.conj().T
    amplitude, modes = np.linalg.eigh(left @ (root[:, None] * kernel * root) @ left)
    amplitude, modes = amplitude[2:], modes[:, 2:]
    power = np.abs(modes.conj().T @ (root * (apart_px[:, 0] + 1j * apart_px[:, 1]))) ** 2
    total = FIELD_PX[:, None, None] ** 2 * np.maximum(amplitude, 0) + NOISE_PX[:, None] ** 2
    log_likelihood = -(np.log(total) + power / (2 * total)).sum(-1)
    log_prior = -1.5 * np.log1p((FIELD_PX / USUAL_PX) ** 2) + np.log(np.gradient(FIELD_PX))
    mass = np.exp(log_likelihood - log_likelihood.max()).sum(1) * np.exp(log_prior)
    return float(mass @ FIELD_PX**2 / mass.sum())


def _kernel(at_ne_m: FloatArray) -> tuple[FloatArray, NDArray[np.complex128]]:
    """(N, N) correlation of the field between places (N, 2), and these as complex numbers in sides of the square they fill."""
    z = at_ne_m[:, 0] + 1j * at_ne_m[:, 1]
    z = z - z.mean()
    at = z / max(float(np.sqrt(6 * np.mean(np.abs(z) ** 2))), 1e-9)
    return np.asarray(np.exp(-0.5 * np.abs(at[:, None] - at) ** 2)), at
