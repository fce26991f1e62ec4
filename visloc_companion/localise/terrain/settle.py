"""A refined place settled under the model's errors, as they are alike nearby, and with what stands on the ground told apart.

Fisher scoring as in refine.py, with the covariance of whitening.py and the shares of standing.py. Crowns without gaps fit as a
ground that is higher and rougher, from where a fit does not come down: it is begun from a higher vehicle, too, and the likelier
of both under the prior's height is taken.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.terrain.base import Kind
from visloc_companion.localise.terrain.noise import Stated, told
from visloc_companion.localise.terrain.refine import (
    DONE_M,
    LEAST_RELIABLE,
    SIGMA_BOUNDS,
    STANDS,
    STATED,
    STEP_CELLS,
    Fitting,
    Refined,
    errors_of,
    left,
    linearised,
    prior_information,
    scaled,
)
from visloc_companion.localise.terrain.standing import Standing, at_first, refitted, told_apart
from visloc_companion.localise.terrain.walked import walked
from visloc_companion.types import FloatArray

ROUNDS = 40
FIRST_ROUNDS = 4
"""Of the shares, before the place moves."""
LIFTS_M = (0.0, 4.0)
"""By which the vehicle is higher where it is begun."""


@dataclass(frozen=True, slots=True, eq=False)
class _Settled:
    """There the derivative by the unknowns `J` (N, 10), and which soundings are on `known` model and how likely `ground` (N,)."""

    unknowns: FloatArray
    standing: Standing
    J: FloatArray
    known: NDArray[np.bool_]
    ground: FloatArray
    log_posterior: float
    converged: bool


def settled(fitting: Fitting, found: Refined) -> Refined:
    """The place, and what is claimed of it. It is judged by what was found: likelihoods, shares and noise are those of soundings
    that count alike. What did not converge is left as it is."""
    if not found.converged:
        return found
    weight = prior_information(fitting.prior)
    both = [_from(fitting, found, lift, weight) for lift in LIFTS_M]
    best = max(both, key=lambda one: (one.converged, one.log_posterior))
    errors = errors_of(fitting, best.standing.sigma_m, best.ground, best.known)
    by_each, (full, under_errors) = errors.solved(best.J), errors.told(best.J)
    if fitting.soundings.kind is Kind.PROFILE:  # its cells are too few for anything to average out
        under_errors = full
    true = told(best.standing.noise()) * scaled(full, np.eye(2) * math.sqrt(max(found.reliability, LEAST_RELIABLE)))
    covariance, inverse = left(fitting, true, fitting.few * under_errors, weight)
    covariance[2, 2] += STANDS * max(0.0, best.standing.sigma_m**2 - fitting.noise.sigma_m**2)
    of_time = walked(by_each @ inverse[2], fitting.soundings.age_s)
    covariance[2, 2] -= min(fitting.walk_m2_per_s * of_time.now_m2, covariance[2, 2])  # `walked` carries it on again
    return replace(
        found,
        unknowns=best.unknowns,
        covariance=(covariance + covariance.T) / 2,
        walked=of_time,
        by_drift=np.asarray(inverse[:2, 6:] @ weight[6:, 6:], dtype=np.float64),
        converged=best.converged,
    )


def _from(fitting: Fitting, found: Refined, lift_m: float, weight: FloatArray) -> _Settled:
    """Settled from a height above the one that was found."""
    cells, expected = fitting.cells, fitting.noise
    bounds = SIGMA_BOUNDS[0] * expected.sigma_m, SIGMA_BOUNDS[1] * expected.sigma_m
    stated = Stated(expected.sigma_m, STATED / fitting.temper)
    unknowns, standing = found.unknowns.copy(), at_first(expected, cells)
    unknowns[2] += lift_m
    last, gain, converged = unknowns[:3] * 0, 1.0, False
    for turn in range(ROUNDS):
        difference, J, known = linearised(fitting, unknowns)
        for _ in range(1 if turn else FIRST_ROUNDS):
            standing = refitted(standing, cells, difference, known, bounds, stated)
        ground = told_apart(standing, cells, difference).ground
        errors = errors_of(fitting, standing.sigma_m, ground, known)
        by_each = errors.solved(J)
        step = np.linalg.solve(J.T @ by_each + weight, by_each.T @ difference - weight @ unknowns)
        if float(step[:3] @ last) < 0:  # what is ground changes with the place: it would go to and fro
            gain /= 2
        far = float(np.hypot(step[0], step[1])) / (STEP_CELLS * fitting.terrain.cell_m)
        unknowns, last = unknowns + gain * step / max(1.0, far), np.asarray(step[:3], dtype=np.float64)
        converged = float(np.abs(step[:3]).max()) < DONE_M
        if converged:
            break
    difference, J, known = linearised(fitting, unknowns)
    apart = told_apart(standing, cells, difference)
    density = fitting.temper * float(apart.log_density[known].sum())
    of_unknowns = -0.5 * float(unknowns[3:] @ weight[3:, 3:] @ unknowns[3:])
    of_height = -0.5 * (float(unknowns[2]) / fitting.prior.sigma_h_m) ** 2
    of_sigma = Stated(expected.sigma_m, STATED).log_prior(standing.sigma_m)
    return _Settled(unknowns, standing, J, known, apart.ground, density + of_unknowns + of_height + of_sigma, converged)
