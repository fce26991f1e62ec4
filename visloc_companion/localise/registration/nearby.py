"""How far a place may be off by the scores about it: what the slopes of a relief, which noise has as well, do not tell.

The covariance of a refinement is that of one optimum. Along a dam or a single hedge, and between the rows of an orchard, places a
few metres off agree as well, and which of them is refined is chance. They are too near to be other places (search.APART_M), so
they are counted as uncertainty of this one, each by how likely its score makes it.

Over land that has changed the score of a whole cloud tells little of that: what was felled or ploughed resembles a place beside
no less than its own. The blocks that have not changed do tell (consensus.py).
"""

from __future__ import annotations

import numpy as np

from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.consensus import beside
from visloc_companion.localise.registration.correlation import NO_SCORE, Scores
from visloc_companion.localise.registration.handicap import of_place
from visloc_companion.localise.registration.pair import Pair
from visloc_companion.localise.registration.refine import ALIKE
from visloc_companion.localise.registration.search import APART_M
from visloc_companion.localise.registration.surfaces import SourceCells, Surface
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


def of_blocks(source: SourceCells, relief: Surface, T: FloatArray) -> tuple[float, FloatArray]:
    """By how many nats the source's blocks make where T (4, 4) puts them likelier than any place beside it, and (2, 2) east,
    north: second moment about it of these, as spread_m2 but by the blocks. ALIKE cells of a block count as one."""
    found = beside(source, relief, T)
    nats, away = found.nats / ALIKE, np.hypot(*np.moveaxis(found.at_m, -1, 0))
    own, near = away <= OWN_M, away < APART_M
    lead = float(nats[own].max() - np.max(nats, where=near & ~own, initial=0.0))
    weight = np.where(near, np.exp(nats - nats[near].max()), 0.0)[..., None]
    off = np.where(own[..., None], 0.0, found.at_m)
    return lead, np.asarray(np.einsum("vui,vuj->ij", off * weight, off) / weight.sum(), dtype=np.float64)
