"""What a GNSS that is trusted tells of where the filter is: for its level alone, it moves nothing.

Where fixes claim more than GNSS may be off by, high above a coarse map or with a mounting that is known to a degree, most of what
they claim is one error: on one heading the mounting, the ground's slope and the map move all fixes alike. Fixes cannot tell how
large it is; a GNSS beside them can, of their sum.

So one more solution (`HELD`) is kept beside the filter: the filter as it was when a trusted GNSS last told the place, which took
that position as well. It takes all that the filter takes, and is where the vehicle is if that GNSS was right; the filter is if it
was false (integrity.py), with the probability that the monitor has for that, but never less than is assumed of a GNSS that was
lost (refused.DRAGGED). What a mounting does to fixes turns with the vehicle: where that is no state of its own (lasting.py) it is
left to the fixes again on another heading; so it is once they have told the filter as much.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from visloc_companion.core.filter import separation
from visloc_companion.core.filter.belief import Belief
from visloc_companion.core.filter.propagation import H_POSITION
from visloc_companion.core.filter.separation import HELD, Solutions
from visloc_companion.types import FloatArray, Vec2

NEWS = 0.8
"""A position is no news that leaves more than this share of the filter's variance; nor is what is left of one later."""
TURNED_RAD = math.radians(20.0)
"""What has turned by more is another heading: of what a mounting does to fixes a third is new."""


@dataclass(frozen=True, slots=True)
class BesideGnss:
    """Where a trusted GNSS has the vehicle at a time, metres north and east, and its variance per axis. What the map is off by is
    not in it: the level adds that to whatever the solution says, of which it is in no more than the filter's share."""

    t_ns: int
    p_ne_m: Vec2
    var_m2: float


ONE_OF_ONE, UNIT = np.ones(1), np.eye(2)
"""They are never changed."""


def tells(belief: Belief, var_m2: float) -> bool:
    """Whether a position of this variance is news to a filter that fixes hold."""
    return belief.last_fix_ns is not None and var_m2 <= NEWS * (_variance_m2(belief.P) + var_m2)


def held(belief: Belief, z: BesideGnss, n_considered: int) -> Belief:
    """The belief with the solution that GNSS holds founded anew, without one where that is no news. The last `n_considered`
    states keep what they are (kalman.update)."""
    without = released(belief.without)
    if not tells(belief, z.var_m2):
        return belief._replace(without=without)
    own = Solutions(belief.x[None], belief.P[None], ONE_OF_ONE, np.array([belief.rested_ns]), (HELD,), (frozenset(),))
    told = separation.updated(
        own, np.array(z.p_ne_m), z.var_m2 * UNIT, H_POSITION, take=np.array([True]), n_considered=n_considered
    )
    state = told.x[0], told.P[0], belief.rested_ns
    headings_rad = None if belief.headings_rad is None else (belief.headings_rad[1], belief.headings_rad[1])
    return belief._replace(without=separation.beside(without, state, (HELD,), 1.0, frozenset()), headings_rad=headings_rad)


def released(without: Solutions) -> Solutions:
    """The solutions without the one that GNSS holds."""
    if HELD not in without.leaves:
        return without
    return separation.chosen(without, np.array([leaves != HELD for leaves in without.leaves], dtype=np.bool_))


def looked(belief: Belief, heading_rad: float | None, mounting_rad: float = 0.0) -> Belief:
    """The belief before a fix of a camera with this heading: on another one than the last when GNSS told, fixes err by something
    else, but where it is known what the mounting has of them (its 1-sigma, `mounting_rad`): that is a state, and turns along."""
    if heading_rad is None:
        return belief
    told_rad = heading_rad if belief.headings_rad is None else belief.headings_rad[0]
    turned = abs(math.remainder(heading_rad - told_rad, math.tau)) > TURNED_RAD
    without = released(belief.without) if turned and mounting_rad == 0 else belief.without
    return belief._replace(headings_rad=(told_rad, heading_rad), without=without)


def kept(belief: Belief) -> Belief:
    """The belief after a fix, without the solution that GNSS holds once fixes have told the filter as much."""
    without = belief.without
    if HELD not in without.leaves:
        return belief
    nn, _, _, ee = without.position_m2[:, without.leaves.index(HELD)].tolist()
    return belief if (nn + ee) / 2 <= NEWS * _variance_m2(belief.P) else belief._replace(without=released(without))


def _variance_m2(P: FloatArray) -> float:
    return float((P[0, 0] + P[1, 1]) / 2)
