"""How far a place may be off by the scores about it: what the slopes of a relief, which noise has as well, do not tell.

The covariance of a refinement is that of one optimum. Along a dam or a single hedge, and between the rows of an orchard, places a
few metres off agree as well, and which of them is refined is chance. They are too near to be other places (search.APART_M), so
they are counted as uncertainty of this one, each by how likely its score makes it.
"""

from __future__ import annotations

import numpy as np

from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.correlation import NO_SCORE, Scores
from visloc_companion.localise.registration.handicap import of_place
from visloc_companion.localise.registration.pair import Pair
from visloc_companion.localise.registration.search import APART_M
from visloc_companion.types import FloatArray

OWN_M = 2.5
"""How sharp a peak is within this, the refinement knows better."""
NATS = 300.0
"""Log-odds that a difference of 1 between two scores a few metres apart is worth: their noise is nearly the same, beside that of
places far from each other (handicap.NATS)."""


def spread_m2(pair: Pair, scores: Scores, at_m: FloatArray, prior: RegistrationPrior) -> FloatArray:
    """(2, 2) east, north: second moment about a place (2,) of the places within APART_M, by their scores alone.

    The prior's own handicap is taken out of the scores again: a fix is weighed with the prior by whoever uses it.
    """
    cell = pair.reference.cell_m
    first, rows_cols = np.array(scores.origin), scores.score.shape
    middle, here = (pair.reference.cells_of(xy) - first for xy in (pair.centre_m[:2], at_m))
    u, v = np.arange(rows_cols[1]), np.arange(rows_cols[0])[:, None]
    east, north = np.broadcast_arrays(cell * (u - here[0]), cell * (v - here[1]))
    away = np.hypot(east, north)
    near = (away < APART_M) & (scores.score > NO_SCORE)
    if not near.any():
        return np.zeros((2, 2))
    score = (scores.score + of_place(cell * (u - middle[0]), cell * (v - middle[1]), prior))[near].astype(np.float64)
    weight = np.exp(NATS * (score - score.max()))
    off = np.column_stack([east[near], north[near]]) * (away[near] > OWN_M)[:, None]
    return np.asarray((off * weight[:, None]).T @ off / weight.sum(), dtype=np.float64)
