"""The position filter's belief, the positions that it takes, and plain changes of it. What it learns: fusion.py."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from visloc_companion.core.filter import alike, relocalise, separation
from visloc_companion.core.filter.claims import Claim
from visloc_companion.core.filter.lasting import LEAST_APART_M, Mounting
from visloc_companion.core.filter.lean import UPRIGHT
from visloc_companion.core.filter.propagation import (
    FIX_LENS,
    N_STATES,
    ODOMETRY_LENS,
    ODOMETRY_LENS_SIGMA,
    POSITION,
    VELOCITY,
    Drive,
    initial_covariance,
)
from visloc_companion.core.filter.votes import LEAST_SPACING_M, Votes
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import Cov2, FloatArray, Vec2

FIX_WEIGHT = 0.2
"""Weight of the latest fix in means over recent ones."""
LONGEST_S, LEAST_M2 = 2.0, 1e-4
NEVER_OFF = alike.none(N_STATES, 2)


@dataclass(frozen=True, slots=True, eq=False)
class Former:
    """The velocity that drove the filter until it became another: from when to when, and its error at the end, mean (2,) and
    covariance (2, 2), m/s."""

    since_ns: int
    until_ns: int
    error_ne_mps: FloatArray
    cov_m2ps2: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """What one interval of odometry, `since_ns` to `t_ns`, said against all that was known: the driving velocity's error (2,) and
    its covariance (2, 2), and the covariance (2, 2) that was believed of it until then; m/s."""

    since_ns: int
    t_ns: int
    error_ne_mps: FloatArray
    cov_m2ps2: FloatArray
    believed_m2ps2: FloatArray


class Belief(NamedTuple):
    """The filter at `t_ns`: mean x (17,), covariance P (17, 17), and its memory.

    `travel_ne_m`: the integral of the driving velocity; `moved_ne_m`: how far the propagation carried the position (for an
    inertial velocity without the error that it knows of). `votes`: what each method said last (votes.py); `without`: the
    solutions that leave fixes out (separation.py); `lean`: to which side fixes have come out lately (lean.py);
    `apart_m`: the way after which fixes look at other ground; `fix_per_m2`: the mean inverse of the variance per axis that
    recent fixes claimed, `fix_every_s` that of the intervals between them (0 before the second fix); `former`: what drove it
    before `drive`; `doubt`: what odometry says of the velocity that drives it and no second interval has confirmed;
    `claims`: by how much the fixes of each method err more than they claim (claims.py); `fed_back_over`: by what factor the
    variance of a velocity that rests on our fixes is larger than the model says (fed_back.py); `lens_share`: 1-sigma of the focal
    length, a share, beside what is believed of every lens; `contradicting`: fixes that were rejected since the filter agreed with
    one of their method (contradiction.py); `alike`: by what the filter may be off if fixes are wrong alike (alike.py);
    `headings_rad`: those of the camera that the last fix had when GNSS last told the level what fixes have in common, and has now
    (by_gnss.py); `mounting_rad`: 1-sigma of the mounting that its states are in, 0 before a fix told one. A tuple, since some
    fifty are made for a second of flight; two are never compared.
    """

    t_ns: int
    x: FloatArray
    P: FloatArray
    sigma_v_mps: float
    sigma_a_mps2: float
    drive: Drive
    travel_ne_m: Vec2
    moved_ne_m: Vec2
    started_ns: int
    last_fix_ns: int | None = None
    rejected: tuple[relocalise.Candidate, ...] = ()
    votes: Votes = ()
    without: separation.Solutions = separation.NONE
    lean: Vec2 = UPRIGHT
    apart_m: float = LEAST_APART_M
    fix_per_m2: float = 0.0
    fix_every_s: float = 0.0
    former: Former | None = None
    doubt: Doubt | None = None
    claims: tuple[Claim, ...] = ()
    fed_back_over: float = 1.0
    lens_share: float = 0.0
    contradicting: tuple[relocalise.Candidate, ...] = ()
    alike: alike.Alike = NEVER_OFF
    headings_rad: Vec2 | None = None
    mounting_rad: float = 0.0

    @property
    def rested_ns(self) -> int:
        """The time of the last fix, or of the start before the first."""
        return self.started_ns if self.last_fix_ns is None else self.last_fix_ns

    @property
    def fix_noise_m2s(self) -> float:
        """Variance times interval of equal fixes that would tell as much in the same time; 0 before the second fix."""
        return self.fix_every_s / self.fix_per_m2 if self.fix_per_m2 > 0 else 0.0

    def after_fix(self, t_ns: int, var_m2: float) -> Belief:
        """With another fix of this variance in the means over recent ones, and as the last. No interval counts for more than
        LONGEST_S: when nothing was recognised for a while, fixes are not rare for that."""
        per_m2 = 1 / max(var_m2, LEAST_M2)
        if self.last_fix_ns is None:
            return self._replace(last_fix_ns=t_ns, fix_per_m2=per_m2, fix_every_s=0.0)
        every_s = min(LONGEST_S, (t_ns - self.last_fix_ns) * 1e-9)
        return self._replace(
            last_fix_ns=t_ns,
            fix_per_m2=self.fix_per_m2 + FIX_WEIGHT * (per_m2 - self.fix_per_m2),
            fix_every_s=self.fix_every_s + FIX_WEIGHT * (every_s - self.fix_every_s) if self.fix_every_s > 0 else every_s,
        )


@dataclass(frozen=True, slots=True)
class Position:
    """A horizontal position measurement. `from_fix` tells vision from GNSS; `apart_m`: after this way what fixes have in common
    has gone by; `view_ne_m`: from there to the ground looked at, ground `spacing_m` further on is other ground (votes.py);
    `per_focal_ne_m`: what a lens that is longer than calibrated adds to it, per share of the focal length; `heading_rad`: of the
    camera, None without one; `mounting_rad`: 1-sigma, on each axis, of its mounting as the covariance has it, 0 where that is
    not known, and `height_m`, over which it errs on the ground."""

    t_ns: int
    p_ne_m: Vec2
    cov_ne_m2: Cov2
    from_fix: bool
    method: str = ""
    probability_wrong: float = 0.0
    tie: int = 0
    apart_m: float = LEAST_APART_M
    per_focal_ne_m: Vec2 = (0.0, 0.0)
    view_ne_m: Vec2 = (0.0, 0.0)
    spacing_m: float = LEAST_SPACING_M
    heading_rad: float | None = None
    mounting_rad: float = 0.0
    height_m: float = 0.0

    @property
    def mounting(self) -> Mounting | None:
        """What the camera's mounting has of it; None where that is not known."""
        if self.mounting_rad == 0 or self.heading_rad is None:
            return None
        return Mounting(self.mounting_rad * abs(self.height_m), self.heading_rad)

    def looks_at_ne_m(self, place_ne_m: FloatArray) -> Vec2:
        """The ground looked at (metres north, east) by who is at a place (2,)."""
        return float(place_ne_m[0]) + self.view_ne_m[0], float(place_ne_m[1]) + self.view_ne_m[1]


def seeded(t_ns: int, p_ne_m: Vec2, sigma_m: float, sigma_v_mps: float, drive: Drive, settings: NavigatorSettings) -> Belief:
    """A belief that starts from one position."""
    x = np.zeros(N_STATES)
    x[POSITION] = p_ne_m
    sigma_a = settings.acceleration_sigma_mps2
    P = initial_covariance(sigma_m, sigma_v_mps, sigma_a)
    return Belief(t_ns, x, P, sigma_v_mps, sigma_a, drive, (0.0, 0.0), (0.0, 0.0), t_ns)


def renewed(belief: Belief, which: slice, variance: float) -> Belief:
    """With two states of which nothing is known any more but their variance."""
    x, P = separation.renewed(belief.x, belief.P, which, variance)
    others_x, others_P = separation.renewed(belief.without.x, belief.without.P, which, variance)
    others = replace(belief.without, x=others_x, then=others_P, way=None)
    return belief._replace(x=x, P=P, without=others, alike=alike.renewed(belief.alike, which))


def driven_by(belief: Belief, drive: Drive, variance: float) -> Belief:
    """With another velocity, of which only the variance of its error is known; what was known of the one before is kept."""
    since_ns = belief.started_ns if belief.former is None else belief.former.until_ns
    former = Former(since_ns, belief.t_ns, belief.x[VELOCITY], belief.P[VELOCITY, VELOCITY])
    return renewed(belief, VELOCITY, variance)._replace(drive=drive, former=former, doubt=None)


def blurred(belief: Belief, sigma_m: float) -> Belief:
    """The belief with an independent position error added."""
    return widened(belief, sigma_m**2, 0.0)


def widened(belief: Belief, position_m2: float, velocity_m2ps2: float) -> Belief:
    """The belief with independent errors of position and of the velocity's error added, on each axis."""
    more = np.zeros((N_STATES, N_STATES))
    more[POSITION, POSITION], more[VELOCITY, VELOCITY] = position_m2 * np.eye(2), velocity_m2ps2 * np.eye(2)
    return widened_by(belief, more)


def lens_doubted(belief: Belief, share: float, per_focal_ne_m: Vec2) -> Belief:
    """With a lens that may be longer or shorter than calibrated by a share (1-sigma) beside what is believed of every lens.

    The position rests on fixes that had the same error: `per_focal_ne_m` is what it adds to the last of them.
    """
    fixes, odometry = np.zeros(N_STATES), np.zeros(N_STATES)
    more_share = math.sqrt(max(0.0, share**2 - belief.lens_share**2))
    fixes[FIX_LENS], odometry[ODOMETRY_LENS] = more_share, more_share
    fixes[POSITION] = -more_share * np.array(per_focal_ne_m)
    more = np.outer(fixes, fixes) + np.outer(odometry, odometry)
    return widened_by(belief, more)._replace(lens_share=share)


def lens_known(belief: Belief, share: float) -> Belief:
    """With another lens, which may be off by a share (1-sigma) beside what is believed of every lens."""
    anew = renewed(belief, slice(ODOMETRY_LENS, FIX_LENS + 1), share**2 + ODOMETRY_LENS_SIGMA**2)
    return anew._replace(lens_share=share)


def widened_by(belief: Belief, more: FloatArray) -> Belief:
    """The belief with a covariance (17, 17) added."""
    return belief._replace(P=belief.P + more, without=separation.widened(belief.without, more))
