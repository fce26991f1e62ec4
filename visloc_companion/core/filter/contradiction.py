"""What one method says again and again while fixes of another hold the filter, which refuses it.

Rejected fixes that agree with each other move a filter that nothing else holds (relocalise.py). Where fixes of another method are
taken in between, one of the two methods is wrong for as long, and nobody knows which: a map whose picture does not lie on its
surface shows it so. The filter stays where it is, for it must not go to and fro between two places; but the level has to reach
both.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from visloc_companion.core.filter import separation
from visloc_companion.core.filter.belief import Belief
from visloc_companion.core.filter.propagation import POSITION
from visloc_companion.core.filter.relocalise import SPAN_S, Candidate, coincide, standing
from visloc_companion.core.filter.separation import ONE, Solutions
from visloc_companion.core.settings import NavigatorSettings

EITHER = 0.5
"""Probability that the one is right that is refused: an assumption."""


def agreed(refused: tuple[Candidate, ...], method: str) -> tuple[Candidate, ...]:
    """What is refused once the filter has taken a fix of a method as an ordinary one."""
    return tuple(each for each in refused if each.method != method)


def beside(belief: Belief, settings: NavigatorSettings) -> Solutions:
    """The solutions that a level is made of: those that leave fixes out, and one for each method that contradicts."""
    solutions = belief.without
    for method in sorted({each.method for each in belief.contradicting}):
        newest = _repeated([each for each in belief.contradicting if each.method == method], belief, settings)
        if newest is not None:
            x, P = belief.x.copy(), belief.P.copy()
            x[POSITION] = np.add(newest.anchor_ne_m, belief.moved_ne_m)
            drifted_m = _sigma_v_mps(belief, settings) * (belief.t_ns - newest.t_ns) * 1e-9
            P[POSITION, POSITION] = np.array(newest.cov_ne_m2) + drifted_m**2 * np.eye(2)
            solutions = separation.beside(solutions, (x, P, newest.t_ns), (ONE,), EITHER, frozenset())
    return solutions


def _repeated(refused: list[Candidate], belief: Belief, settings: NavigatorSettings) -> Candidate | None:
    """The newest of the fixes of a method that were refused, where as many as would move a filter agree, and lately."""
    last, sigma_v_mps = refused[-settings.relocalise_after_rejections :], _sigma_v_mps(belief, settings)
    few = len(last) < settings.relocalise_after_rejections
    if few or belief.t_ns - last[-1].t_ns > SPAN_S * 1e9 or standing(last):
        return None
    agree = all(coincide(a, b, sigma_v_mps, settings.gate_sigma) for a, b in combinations(last, 2))
    return last[-1] if agree else None


def _sigma_v_mps(belief: Belief, settings: NavigatorSettings) -> float:
    return max(belief.sigma_v_mps, settings.velocity_sigma_aiding_mps)
