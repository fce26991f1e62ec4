"""Fixes that odometry contradicts are left out: the filter goes on from the likeliest solution that does without them.

A wrong fix pulls position and velocity alike; odometry, which rests on no fix, then contradicts the velocity. Of the solutions
that leave fixes out (separation.py), each with the probability that those fixes are wrong, one may say what odometry says. The
other explanation is that odometry was deceived (shadows, water), and then its velocity may be anything. Fault detection and
exclusion by solution separation: Blanch et al., "Baseline advanced RAIM user algorithm and possible improvements", 2015.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from visloc_companion.core.filter import alike, by_gnss
from visloc_companion.core.filter.belief import Belief
from visloc_companion.core.filter.lean import UPRIGHT
from visloc_companion.core.filter.separation import CLAIM_FLOOR, ONE, Solutions, beside, chosen
from visloc_companion.types import FloatArray

DECEIVED, WITHIN_MPS = 0.01, 20.0
"""Probability that an interval of odometry is deceived that contradicts the filter, and the span of its velocity then, north and
east."""
AGREES_NIS, SUSPECT_NIS = 6.0, 9.0
"""Normalised squared innovations that one interval in 20, and one in 90, exceeds."""
LIKELIER = 10.0
"""By so much another solution must explain an interval better than the filter and than deceived odometry."""


def excluding(belief: Belief, z: FloatArray, R: FloatArray, H: FloatArray) -> Belief | None:
    """The belief without the fixes that a measurement z (2,), R (2, 2) of H x, H (2, n), contradicts; None where no solution
    explains it better. What the filter said until now stays among the solutions."""
    if not len(belief.without):
        return None
    (own_nis,), (own_density,) = _seen(z, R, H, belief.x[None], belief.P[None])
    if own_nis <= SUSPECT_NIS:
        return None
    among = by_gnss.released(belief.without)
    if not len(among):
        return None
    nis, density = _seen(z, R, H, among.x, among.P)
    likelihood = among.probability * density
    best = int(likelihood.argmax())
    otherwise = float(own_density) + DECEIVED / WITHIN_MPS**2
    if nis[best] > AGREES_NIS or likelihood[best] <= LIKELIER * otherwise:
        return None
    until_now = max(CLAIM_FLOOR, otherwise / float(likelihood[best]))
    without = _beside(among, best, (belief.x, belief.P, belief.rested_ns), until_now)
    rested_ns = int(among.rested_ns[best])
    same = alike.until(belief.alike, rested_ns)
    return belief._replace(x=among.x[best], P=among.P[best], last_fix_ns=rested_ns, without=without, lean=UPRIGHT, alike=same)


def _seen(z: FloatArray, R: FloatArray, H: FloatArray, x: FloatArray, P: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Normalised squared innovation (K,) and probability density (K,) of z for means x (K, n) and covariances P (K, n, n)."""
    off, S = z - x @ H.T, H @ P @ H.T + R
    nis = np.einsum("ki,ki->k", off, np.linalg.solve(S, off[:, :, None])[:, :, 0])
    return nis, np.exp(-nis / 2) / (2 * math.pi * np.sqrt(np.linalg.det(S)))


def _beside(among: Solutions, best: int, before: tuple[FloatArray, FloatArray, int], probability: float) -> Solutions:
    """The solutions beside the one that was chosen: those that rest on none of the fixes that it leaves out, as probable as they
    are if these are wrong, and what the filter said before, mean, covariance and time of its last fix."""
    keep = among.rested_ns <= among.rested_ns[best]
    keep[best] = False
    kept = chosen(among, keep)
    likelier = replace(kept, probability=np.minimum(1.0, kept.probability / among.probability[best]))
    return beside(likelier, before, (ONE,), probability, frozenset())
