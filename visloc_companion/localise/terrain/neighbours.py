"""Places beside each other that fit a stretch alike: the search's modes lie three cells apart and more.

A patch is fitted by one place of a valley, a single line by several: the refinement ends at the one where it began. Of those that
it reaches from about it the likeliest is taken, and by how much the others spread is claimed.
"""

from __future__ import annotations

import numpy as np

from visloc_companion.localise.terrain.base import TerrainPrior
from visloc_companion.localise.terrain.refine import Fitting, Refined, refine
from visloc_companion.types import FloatArray

NEIGHBOURS, NEIGHBOUR_M, APART_M = 6, 25.0, 10.0
"""From so many places so far about the likeliest one it is refined once more; what comes nearer is the same place."""


def squared_sigmas(away_ne_m: FloatArray, prior: TerrainPrior, extra_m: float) -> FloatArray:
    """(...,) of (..., 2) metres from the prior's place, in squared sigmas of the prior and `extra_m` together."""
    cov = np.array(prior.cov_ne_m2) + np.eye(2) * extra_m**2
    return np.asarray(np.einsum("...i,ij,...j->...", away_ne_m, np.linalg.inv(cov), away_ne_m))


def weights_of(found: list[Refined], prior: TerrainPrior) -> FloatArray:
    """Posterior probabilities of refined places under the prior, if there are no others."""
    logs = np.array(
        [
            one.log_likelihood
            - 0.5 * float(squared_sigmas(one.unknowns[:2], prior, 0.0))
            - 0.5 * (one.unknowns[2] / prior.sigma_h_m) ** 2
            + 0.5 * float(np.linalg.slogdet(one.covariance[:3, :3])[1])
            for one in found
        ]
    )
    weights = np.exp(logs - logs.max())
    return np.asarray(weights / weights.sum())


def of_neighbours(fitting: Fitting, place: Refined) -> tuple[Refined, FloatArray]:
    """The likeliest place about a refined one, and (2, 2) by how much the others there spread about it, m²."""
    found = [place]
    for angle in np.arange(NEIGHBOURS) * (2 * np.pi / NEIGHBOURS):
        start = place.unknowns.copy()
        start[:2] += NEIGHBOUR_M * np.array([np.cos(angle), np.sin(angle)])
        one = refine(fitting, start)
        if _another(one, found) and _another(again := refine(fitting, one.unknowns), found):  # with noise fitted where it ended
            found.append(again)
    weights = weights_of(found, fitting.prior)
    best = found[int(np.argmax(weights))]
    away = np.array([one.unknowns[:2] - best.unknowns[:2] for one in found])
    return best, np.asarray((away * weights[:, None]).T @ away)


def _another(one: Refined, found: list[Refined]) -> bool:
    return one.converged and all(np.hypot(*(one.unknowns[:2] - other.unknowns[:2])) > APART_M for other in found)
