"""A belief revised by what is no measurement: another origin, a clock that leapt, frames of another time, odometry gone wrong."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from visloc_companion.core.filter import separation, votes
from visloc_companion.core.filter.belief import Belief, blurred, widened_by
from visloc_companion.core.filter.fusion import UNAIDED_SIGMA_MPS
from visloc_companion.core.filter.propagation import N_STATES, POSITION, VELOCITY
from visloc_companion.core.filter.relocalise import Candidate
from visloc_companion.types import Vec2


def shifted(belief: Belief, shift_ne_m: Vec2) -> Belief:
    """All that it says of places moved by metres north and east; what it knows of them stays the same."""

    def moved(p: Vec2) -> Vec2:
        return p[0] + shift_ne_m[0], p[1] + shift_ne_m[1]

    def candidates(those: tuple[Candidate, ...]) -> tuple[Candidate, ...]:
        return tuple(replace(c, p_ne_m=moved(c.p_ne_m), anchor_ne_m=moved(c.anchor_ne_m)) for c in those)

    rejected, contradicting = candidates(belief.rejected), candidates(belief.contradicting)
    without = separation.shifted(belief.without, np.array(shift_ne_m))
    x = belief.x.copy()
    x[POSITION] += shift_ne_m
    voted = votes.moved(belief.votes, shift_ne_m)
    return belief._replace(x=x, rejected=rejected, contradicting=contradicting, votes=voted, without=without)


def stood(belief: Belief, stood_s: float) -> Belief:
    """Carried on through so many seconds that no clock showed, at a velocity known no better than where none arrives."""
    return blurred(belief, UNAIDED_SIGMA_MPS * stood_s)


def leapt(belief: Belief, v_ne_mps: Vec2, leapt_s: float) -> Belief:
    """As much further back as the velocity makes of seconds that were counted and did not go by."""
    return blurred(shifted(belief, (-v_ne_mps[0] * leapt_s, -v_ne_mps[1] * leapt_s)), UNAIDED_SIGMA_MPS * leapt_s)


def retimed(belief: Belief, v_ne_mps: Vec2, later_s: float) -> Belief:
    """Off by the way of a time, along the velocity: frames were taken so much later than their fixes said."""
    more = np.zeros((N_STATES, N_STATES))
    way_ne_m = later_s * np.array(v_ne_mps)
    more[POSITION, POSITION] = np.outer(way_ne_m, way_ne_m)
    return widened_by(belief, more)


def motion_doubted(belief: Belief, v_ne_mps: Vec2, autopilots_ne_mps: Vec2) -> Belief:
    """What odometry has taught since the last fix was wrong: the velocity may be off by what makes it another than the
    autopilot's, and the position by the way of that since then."""
    off_m2ps2 = math.dist(v_ne_mps, autopilots_ne_mps) ** 2 * np.eye(2)
    for_s = max(0.0, (belief.t_ns - belief.rested_ns) * 1e-9)
    more = np.zeros((N_STATES, N_STATES))
    more[VELOCITY, VELOCITY], more[POSITION, POSITION] = off_m2ps2, for_s**2 * off_m2ps2
    more[POSITION, VELOCITY] = more[VELOCITY, POSITION] = -for_s * off_m2ps2
    return widened_by(belief, more)
