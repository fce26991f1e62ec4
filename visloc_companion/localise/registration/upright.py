"""A place refined from two headings: the one that the search found, and the likeliest one of a Gaussian prior.

One row of trees or a single edge fits almost as well some degrees turned. Where both headings end in different optima of one
place, the better is taken, and what the two differ by is claimed: the covariance of their mixture.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.handicap import NATS
from visloc_companion.localise.registration.headings import are_two, wrapped
from visloc_companion.localise.registration.settle import Settled, Settler
from visloc_companion.localise.registration.similarity import about, moved, scale_of, yaw_of
from visloc_companion.types import FloatArray

MOST_NATS = 50.0


def polished(settler: Settler, found: Settled, prior: RegistrationPrior) -> tuple[Settled, list[Settled]]:
    """The place after its last steps, and another place that the prior's heading led to, if it did.

    Without a Gaussian prior no heading is likelier than another, and the place is polished as it is.
    """
    first = settler.polished(found)
    centre = settler.pair.centre_m
    second = settler.settle(_upright(first, centre)) if prior.gaussian else None
    if second is None:
        return first, []
    second = settler.polished(second)
    best, other = (first, second) if first.found.score >= second.found.score else (second, first)
    if are_two(settler.pair, best.refined.T, other.refined.T):
        return first, [second]
    off = _apart(best.refined.T, other.refined.T, centre)
    share = 1 / (1 + math.exp(min(NATS * (best.found.score - other.found.score), MOST_NATS)))
    placed = best.refined.placed + share * (1 - share) * np.outer(off, off)
    return replace(best, refined=replace(best.refined, placed=placed)), []


def _upright(settled: Settled, centre_m: FloatArray) -> FloatArray:
    """(4, 4) The place that goes with the prior's heading and scale: a relief that is held at one end turns about that end."""
    T, C = settled.refined.T, settled.refined.placed
    turn = np.array([yaw_of(T), math.log(scale_of(T))])
    shift = moved(T, centre_m) - centre_m
    shift[:2] -= C[:2, 2:] @ np.linalg.solve(C[2:, 2:], turn)
    return about(centre_m, 0.0, 1.0, shift)


def _apart(T: FloatArray, other: FloatArray, centre_m: FloatArray) -> FloatArray:
    """(4,) east, north, heading, log scale of one similarity less another's, at the source's middle."""
    shift = moved(T, centre_m) - moved(other, centre_m)
    turn = float(wrapped(np.array(yaw_of(T) - yaw_of(other))))
    return np.array([shift[0], shift[1], turn, math.log(scale_of(T) / scale_of(other))])
