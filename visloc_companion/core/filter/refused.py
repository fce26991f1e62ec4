"""What a belief makes of fixes that it rejects: it remembers them, doubts its velocity, and starts again where they agree."""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.core.filter import alike, by_gnss, lasting, relocalise, separation, votes
from visloc_companion.core.filter.belief import NEVER_OFF, Belief, Position, widened
from visloc_companion.core.filter.propagation import (
    FIX_LENS,
    H_POSITION,
    LASTS,
    N_STATES,
    ODOMETRY_LENS,
    POSITION,
    VELOCITY,
    Drive,
    initial_covariance,
)
from visloc_companion.core.filter.second_opinion import FAR
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import FloatArray

DRAGGED = 0.01
"""Probability that a GNSS which alone was followed, and is trusted no more, had been dragged before: an assumption."""
DOUBT_AFTER = 2
DOUBT_MPS = 4.0
MAX_DOUBT_MPS = 12.0
"""Added 1-sigma of the velocity error for each rejection from the second on, and where that ends."""
OFTEN_S = 1.0
"""Where fixes come no further apart in the mean, one that surprises a filter waits for another."""


def far(belief: Belief, cov_m2: FloatArray) -> bool:
    """Whether a filter is far less sure of its position than a fix with this covariance (2, 2) is of its own."""
    own_m2 = belief.P[POSITION, POSITION]
    return float(np.linalg.norm(own_m2, 2)) > FAR**2 * float(np.linalg.norm(cov_m2, 2))


def soon_another(belief: Belief) -> bool:
    """Whether fixes come often, or too few have been taken to tell."""
    return belief.fix_every_s <= OFTEN_S


def repeated(belief: Belief, z: Position, settings: NavigatorSettings) -> bool:
    """Whether a fix says what one that was refused lately said."""
    sigma_v_mps = max(belief.sigma_v_mps, settings.velocity_sigma_aiding_mps)
    now = _candidate(belief, z)
    lately = (each for each in belief.rejected if z.t_ns - each.t_ns <= relocalise.SPAN_S * 1e9)
    return any(relocalise.coincide(each, now, sigma_v_mps, settings.gate_sigma) for each in lately)


def drifted(belief: Belief, more_m2: FloatArray) -> Belief:
    """A filter that has drifted by more than it knew of: with this covariance (2, 2) added to its position's."""
    P = belief.P.copy()
    P[POSITION, POSITION] += more_m2
    return belief._replace(P=P)


def dragged(belief: Belief, sigma_m: float) -> Belief:
    """With one more solution, which says that a GNSS that was followed had been dragged away by so much (1-sigma). It takes all
    later fixes, so the first of them tells."""
    more = np.zeros((N_STATES, N_STATES))
    more[POSITION, POSITION] = sigma_m**2 * np.eye(2)
    state = belief.x, belief.P + more, belief.rested_ns
    return belief._replace(without=separation.beside(belief.without, state, (separation.ONE,), DRAGGED, frozenset()))


def founded(belief: Belief, z: Position, among: separation.Solutions) -> separation.Solutions:
    """The solutions that leave fixes out, after a fix that the filter took founded new ones."""
    recent = votes.recent(belief.votes, z.t_ns)
    return separation.without_fix(among, z.method, z.probability_wrong, (belief.x, belief.P, belief.rested_ns), recent)


def remembering(belief: Belief, z: Position) -> Belief:
    """With a rejected fix kept in mind."""
    new = _candidate(belief, z)
    contradicting = relocalise.remembered(belief.contradicting, new)
    return belief._replace(rejected=relocalise.remembered(belief.rejected, new), contradicting=contradicting)


def _candidate(belief: Belief, z: Position) -> relocalise.Candidate:
    anchor = (z.p_ne_m[0] - belief.moved_ne_m[0], z.p_ne_m[1] - belief.moved_ne_m[1])
    return relocalise.Candidate(z.t_ns, z.p_ne_m, anchor, z.cov_ne_m2, z.method)


def doubting(belief: Belief, z: Position) -> Belief:
    """After repeated rejections that a wrong velocity could explain: doubt the velocity, so that the search region follows.

    A false velocity (GNSS velocity is spoofed, too) otherwise carries the filter away from the fixes that contradict it.
    """
    off_m = math.hypot(z.p_ne_m[0] - float(belief.x[0]), z.p_ne_m[1] - float(belief.x[1]))
    explained = off_m <= relocalise.MAX_VELOCITY_ERROR_MPS * (z.t_ns - belief.rested_ns) * 1e-9
    doubtful = len(belief.rejected) >= DOUBT_AFTER and explained and not relocalise.standing(belief.rejected)
    if not doubtful or float(belief.P[VELOCITY.start, VELOCITY.start]) > MAX_DOUBT_MPS**2:
        return belief
    return widened(belief, 0.0, DOUBT_MPS**2)


def restarted(belief: Belief, z: Position, found: relocalise.Restart, settings: NavigatorSettings) -> Belief:
    """From the last of the agreeing fixes, with its own covariance: their errors may be one error, so nothing is averaged."""
    sigma_v = max(belief.sigma_v_mps, settings.velocity_sigma_aiding_mps, found.sigma_mps)
    error = found.velocity_error_ne_mps
    x = np.zeros(N_STATES)
    by_lens_m = np.array(z.per_focal_ne_m)
    x[FIX_LENS] = belief.x[FIX_LENS]
    x[POSITION], x[VELOCITY] = np.array(z.p_ne_m) - x[FIX_LENS] * by_lens_m, error
    if belief.drive is Drive.FED_BACK:
        sigma_v, x[VELOCITY] = max(sigma_v, math.hypot(*error)), 0.0
    elif belief.drive is Drive.INERTIAL:
        x[VELOCITY] += belief.x[VELOCITY]
    P = initial_covariance(0.0, sigma_v, belief.sigma_a_mps2)
    cov = np.array(z.cov_ne_m2)
    H, new_m2 = lasting.seen(cov, z.method, z.per_focal_ne_m, z.mounting)
    lasts_m = H[:, LASTS]
    cov = cov if z.mounting is None else lasts_m.dot(lasts_m.T) + new_m2
    P[FIX_LENS, FIX_LENS] = belief.P[FIX_LENS, FIX_LENS]
    P[ODOMETRY_LENS, ODOMETRY_LENS] += belief.lens_share**2
    P[POSITION, POSITION] = cov + P[FIX_LENS, FIX_LENS] * np.outer(by_lens_m, by_lens_m)
    P[POSITION, LASTS], P[LASTS, POSITION] = -lasts_m, -lasts_m.T
    P[POSITION, FIX_LENS] = P[FIX_LENS, POSITION] = -P[FIX_LENS, FIX_LENS] * by_lens_m
    without = founded(belief, z, by_gnss.released(belief.without))
    off_m, S = np.array(z.p_ne_m) - belief.x[POSITION], belief.P[POSITION, POSITION] + cov
    alone = alike.Taken(z.t_ns, z.method, z.probability_wrong, 1.0, off_m, S, H_POSITION, H_POSITION.T)
    north, east = (x - belief.x)[POSITION].tolist()
    return belief._replace(
        x=x,
        P=P,
        started_ns=z.t_ns,
        votes=votes.moved(belief.votes, (north, east)),
        without=without,
        mounting_rad=z.mounting_rad,
        alike=alike.after_fix(NEVER_OFF, alone),
    )
