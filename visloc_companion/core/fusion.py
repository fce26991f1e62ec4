"""One step of the position filter as a pure function: belief and input in, belief out. The log and rewind: estimator.py.

State and process: propagation.py. The velocity that drives the filter is an input, never a measurement; its error is a state.
While an autopilot's velocity descends from our own fixes (`FED_BACK`), correcting it by a learned error and injecting the result
would feed the correction back into its own source and run away, so the error is then only considered (Schmidt), never
estimated, and grows with the time since the last fix. A velocity integrated from accelerations (`INERTIAL`) is fed by
nothing of ours: its error, and that of the acceleration, are learned from fixes and odometry whatever is injected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from visloc_companion.core import kalman, relocalise, separation
from visloc_companion.core.propagation import (
    ACCELERATION,
    N_CONSIDERED,
    N_STATES,
    POSITION,
    VELOCITY,
    Drive,
    initial_covariance,
    transition,
)
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.errors import Reason
from visloc_companion.types import Accepted, Cov2, FloatArray, Rejected, Vec2

H_POSITION: FloatArray = np.eye(N_STATES)[POSITION]
STILL = (0.0,) * (N_STATES - POSITION.stop)
UNAIDED_GAP_S = 1.0
UNAIDED_SIGMA_MPS = 3.0
"""1-sigma of the velocity error where no velocity arrived for UNAIDED_GAP_S, or the autopilot itself does not trust it."""
INERTIAL_DRIFT_MPS2 = 0.03
"""Growth of that sigma while the velocity rests on our own dead reckoning only."""
HEIGHT_WALK_M_PER_SQRT_S = 0.1
HEIGHT_GATE_SIGMA = 4.0
ORDINARY_NIS = 6.0
"""A normalised squared innovation that one position in 20 exceeds. Beyond it, up to the gate, it is rather wrong than unlikely:
its covariance is raised until it would be ordinary, so that it hardly moves the velocity."""
DOUBT_AFTER = 2
DOUBT_MPS = 4.0
MAX_DOUBT_MPS = 12.0
"""Added 1-sigma of the velocity error for each rejection from the second on, and where that ends."""


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """The filter at `t_ns`: mean x (11,), covariance P (11, 11), and its memory.

    `travel_ne_m`: the integral of the driving velocity; `moved_ne_m`: how far the propagation carried the position (for an
    inertial velocity without the error that it knows of). `votes`: each method with the time of its last fix; `without`: the
    solutions that leave fixes out (separation.py).
    """

    t_ns: int
    x: FloatArray
    P: FloatArray
    sigma_v_mps: float
    sigma_a_mps2: float
    drive: Drive
    travel_ne_m: Vec2
    moved_ne_m: Vec2
    height_offset_m: float
    height_var_m2: float
    started_ns: int
    last_fix_ns: int | None = None
    rejected: tuple[relocalise.Candidate, ...] = ()
    votes: separation.Votes = ()
    without: separation.Solutions = separation.NONE

    @property
    def rested_ns(self) -> int:
        """The time of the last fix, or of the start before the first."""
        return self.started_ns if self.last_fix_ns is None else self.last_fix_ns


@dataclass(frozen=True, slots=True)
class Position:
    """A horizontal position measurement. `from_fix` tells vision from GNSS; `h_amsl_m` is a fix's own height."""

    t_ns: int
    p_ne_m: Vec2
    cov_ne_m2: Cov2
    from_fix: bool
    method: str = ""
    probability_wrong: float = 0.0
    h_amsl_m: float | None = None
    sigma_h_m: float = 1.0
    tie: int = 0


def seeded(
    t_ns: int, p_ne_m: Vec2, sigma_m: float, sigma_v_mps: float, drive: Drive, sigma_h_m: float, settings: NavigatorSettings
) -> Belief:
    """A belief that starts from one position."""
    x = np.zeros(N_STATES)
    x[POSITION] = p_ne_m
    sigma_a = settings.acceleration_sigma_mps2
    P = initial_covariance(sigma_m, sigma_v_mps, sigma_a)
    return Belief(t_ns, x, P, sigma_v_mps, sigma_a, drive, (0.0, 0.0), (0.0, 0.0), 0.0, sigma_h_m**2, t_ns)


def with_velocity_trust(belief: Belief, sigma_mps: float, drive: Drive) -> Belief:
    """Account for a change of how far the autopilot's velocity is to be believed, or of what it rests on.

    The latter makes it another velocity, whose error starts anew. A larger sigma takes effect at once; a smaller one over the
    correlation time.
    """
    if drive is not belief.drive:
        renewed = _renewed(belief, VELOCITY, max(sigma_mps, belief.sigma_v_mps) ** 2)
        return replace(renewed, sigma_v_mps=sigma_mps, drive=drive)
    if sigma_mps > belief.sigma_v_mps:
        return replace(widened(belief, 0.0, sigma_mps**2 - belief.sigma_v_mps**2), sigma_v_mps=sigma_mps)
    return belief if sigma_mps == belief.sigma_v_mps else replace(belief, sigma_v_mps=sigma_mps)


def with_inertial_velocity(belief: Belief, sigma_a_mps2: float) -> Belief:
    """Account for an inertial velocity, which begins with the autopilot's: that error goes on.

    `sigma_a_mps2`: 1-sigma of the slow error of its accelerations.
    """
    if belief.drive is not Drive.INERTIAL:
        belief = replace(_renewed(belief, ACCELERATION, sigma_a_mps2**2), drive=Drive.INERTIAL)
    return belief if sigma_a_mps2 == belief.sigma_a_mps2 else replace(belief, sigma_a_mps2=sigma_a_mps2)


def _renewed(belief: Belief, which: slice, variance: float) -> Belief:
    """With two states of which nothing is known any more but their variance."""
    x, P = separation.renewed(belief.x, belief.P, which, variance)
    others_x, others_P = separation.renewed(belief.without.x, belief.without.P, which, variance)
    return replace(belief, x=x, P=P, without=replace(belief.without, x=others_x, P=others_P))


def propagated(
    belief: Belief,
    t_ns: int,
    v_ne_mps: Vec2,
    settings: NavigatorSettings,
    change_ne_mps: Vec2 = (0.0, 0.0),
    *,
    alone: bool = False,
) -> Belief:
    """The belief carried to a later time by a mean velocity; exact for any division of the interval.

    `change_ne_mps`: by how much the driving velocity changes meanwhile. `alone`: leave the solutions behind that leave fixes out.
    """
    dt = (t_ns - belief.t_ns) * 1e-9
    if dt <= 0:
        return belief
    without = separation.NONE if alone else belief.without
    sigmas = _sigmas_mps(belief, without, settings)
    F, Q = transition(dt, belief.drive, sigmas, belief.sigma_a_mps2, change_ne_mps, settings)
    north, east = v_ne_mps[0] * dt, v_ne_mps[1] * dt
    step = np.array((north, east, *STILL))
    x, P = kalman.predict(belief.x, belief.P, F, Q[0], step)
    inertial = belief.drive is Drive.INERTIAL
    moved_north, moved_east = (x - belief.x)[POSITION].tolist() if inertial else (north, east)
    return Belief(
        t_ns,
        x,
        P,
        belief.sigma_v_mps,
        belief.sigma_a_mps2,
        belief.drive,
        (belief.travel_ne_m[0] + north, belief.travel_ne_m[1] + east),
        (belief.moved_ne_m[0] + moved_north, belief.moved_ne_m[1] + moved_east),
        belief.height_offset_m,
        belief.height_var_m2 + HEIGHT_WALK_M_PER_SQRT_S**2 * dt,
        belief.started_ns,
        belief.last_fix_ns,
        belief.rejected,
        belief.votes,
        separation.propagated(without, F, Q[1:], step),
    )


def blurred(belief: Belief, sigma_m: float) -> Belief:
    """The belief with an independent position error added."""
    return widened(belief, sigma_m**2, 0.0)


def widened(belief: Belief, position_m2: float, velocity_m2ps2: float) -> Belief:
    """The belief with independent errors of position and of the velocity's error added, on each axis."""
    more = np.zeros((N_STATES, N_STATES))
    more[POSITION, POSITION], more[VELOCITY, VELOCITY] = position_m2 * np.eye(2), velocity_m2ps2 * np.eye(2)
    return widened_by(belief, more)


def widened_by(belief: Belief, more: FloatArray) -> Belief:
    """The belief with a covariance (11, 11) added."""
    return replace(belief, P=belief.P + more, without=separation.widened(belief.without, more))


def taken(
    belief: Belief, z: FloatArray, R: FloatArray, H: FloatArray, gate_sigma: float = math.inf
) -> tuple[Belief, Accepted | Rejected]:
    """The belief after a measurement z (2,), R (2, 2) of H x, H (2, 11), that is no fix: every solution takes it, too."""
    got = kalman.update(belief.x, belief.P, z, R, H, gate_sigma=gate_sigma)
    if isinstance(got, Rejected):
        return belief, got
    every = np.ones(len(belief.without), np.bool_)
    without = separation.updated(belief.without, z, R, H, take=every, n_considered=0)
    return replace(belief, x=got.x, P=got.P, without=without), Accepted(got.nis)


def _sigmas_mps(belief: Belief, without: separation.Solutions, settings: NavigatorSettings) -> FloatArray:
    """1-sigma (K + 1,) of the velocity's error of the filter and of K solutions; an inertial velocity does without it."""
    sigmas = np.full(1 + len(without), belief.sigma_v_mps)
    if belief.drive is Drive.AUTOPILOT:  # a large learned error does not relax to zero as the model says: allow for that
        sigmas[0] = max(belief.sigma_v_mps, math.hypot(belief.x[2], belief.x[3]) / 2)
        np.maximum(sigmas[1:], np.hypot(without.x[:, 2], without.x[:, 3]) / 2, out=sigmas[1:])
    elif belief.drive is Drive.FED_BACK:
        sigmas[0] += INERTIAL_DRIFT_MPS2 * max(0.0, (belief.t_ns - belief.rested_ns) * 1e-9 - settings.dead_reckoning_after_s)
        rested_s = (belief.t_ns - np.maximum(without.rested_ns, belief.started_ns)) * 1e-9
        sigmas[1:] += INERTIAL_DRIFT_MPS2 * np.maximum(0.0, rested_s - settings.dead_reckoning_after_s)
    return sigmas


def observed(
    belief: Belief, z: Position, h_autopilot_amsl_m: float | None, settings: NavigatorSettings
) -> tuple[Belief, Accepted | Rejected]:
    """The belief after a position at its own time. Rejected fixes that agree with each other restart it at last."""
    considered = N_CONSIDERED if belief.drive is Drive.FED_BACK else 0
    at, R, extra_m2 = np.array(z.p_ne_m), np.array(z.cov_ne_m2), settings.map_sigma_m**2
    got = kalman.update(
        belief.x,
        belief.P,
        at,
        R,
        H_POSITION,
        gate_sigma=settings.gate_sigma,
        gate_extra_m2=extra_m2,
        n_considered=considered,
    )
    if isinstance(got, kalman.Updated) and got.nis > ORDINARY_NIS:
        R = R + (got.nis / ORDINARY_NIS - 1) * (belief.P[POSITION, POSITION] + R + extra_m2 * np.eye(2))
        less = kalman.update(belief.x, belief.P, at, R, H_POSITION, n_considered=considered)
        got = replace(less, nis=got.nis) if isinstance(less, kalman.Updated) else less
    if isinstance(got, kalman.Updated):
        after = replace(belief, x=got.x, P=got.P, without=_others(belief, z, R, considered))
        return (_fixed(after, z, h_autopilot_amsl_m) if z.from_fix else after), Accepted(got.nis)
    if not z.from_fix or got.reason is not Reason.GATED:
        return belief, got
    belief = _remembering(belief, z)
    restart = relocalise.restart(belief.rejected, belief.sigma_v_mps, settings)
    if restart is None:
        return _doubting(belief, z), got
    return _fixed(_restarted(belief, z, restart, settings), z, h_autopilot_amsl_m), Accepted(got.nis)


def _others(belief: Belief, z: Position, cov: FloatArray, n_considered: int) -> separation.Solutions:
    """The solutions that leave fixes out, after a position that the filter took."""
    among = belief.without
    take = ~separation.leaving_out(among, z.method) if z.from_fix else np.ones(len(among), np.bool_)
    at, rests_ns = np.array(z.p_ne_m), z.t_ns if z.from_fix else None
    among = separation.updated(among, at, cov, H_POSITION, take=take, n_considered=n_considered, t_ns=rests_ns)
    return _founded(belief, z, among) if z.from_fix else among


def _founded(belief: Belief, z: Position, among: separation.Solutions) -> separation.Solutions:
    recent = separation.recent(belief.votes, z.t_ns)
    return separation.without_fix(among, z.method, z.probability_wrong, (belief.x, belief.P, belief.rested_ns), recent)


def _remembering(belief: Belief, z: Position) -> Belief:
    anchor = (z.p_ne_m[0] - belief.moved_ne_m[0], z.p_ne_m[1] - belief.moved_ne_m[1])
    new = relocalise.Candidate(z.t_ns, z.p_ne_m, anchor, z.cov_ne_m2)
    return replace(belief, rejected=relocalise.remembered(belief.rejected, new))


def _doubting(belief: Belief, z: Position) -> Belief:
    """After repeated rejections that a wrong velocity could explain: doubt the velocity, so that the search region follows.

    A false velocity (GNSS velocity is spoofed, too) otherwise carries the filter away from the fixes that contradict it.
    """
    off_m = math.hypot(z.p_ne_m[0] - float(belief.x[0]), z.p_ne_m[1] - float(belief.x[1]))
    explained = off_m <= relocalise.MAX_VELOCITY_ERROR_MPS * (z.t_ns - belief.rested_ns) * 1e-9
    doubtful = len(belief.rejected) >= DOUBT_AFTER and explained and not relocalise.standing(belief.rejected)
    if not doubtful or float(belief.P[2, 2]) > MAX_DOUBT_MPS**2:
        return belief
    return widened(belief, 0.0, DOUBT_MPS**2)


def _restarted(belief: Belief, z: Position, found: relocalise.Restart, settings: NavigatorSettings) -> Belief:
    """From the last of the agreeing fixes, with its own covariance: their errors may be one error, so nothing is averaged."""
    sigma_v = max(belief.sigma_v_mps, settings.velocity_sigma_aiding_mps, found.sigma_mps)
    error = found.velocity_error_ne_mps
    x = np.zeros(N_STATES)
    x[POSITION], x[VELOCITY] = z.p_ne_m, error
    if belief.drive is Drive.FED_BACK:
        sigma_v, x[VELOCITY] = max(sigma_v, math.hypot(*error)), 0.0
    elif belief.drive is Drive.INERTIAL:
        x[VELOCITY] += belief.x[VELOCITY]
    P = initial_covariance(0.0, sigma_v, belief.sigma_a_mps2)
    P[POSITION, POSITION] = np.array(z.cov_ne_m2)
    without = _founded(belief, z, belief.without)
    return replace(belief, x=x, P=P, started_ns=z.t_ns, without=without)


def _fixed(belief: Belief, z: Position, h_autopilot_amsl_m: float | None) -> Belief:
    votes = separation.voted(belief.votes, z.method, z.t_ns)
    without = separation.apart(belief.without, belief.x, belief.P)
    after = replace(belief, last_fix_ns=z.t_ns, rejected=(), votes=votes, without=without)
    if z.h_amsl_m is None or h_autopilot_amsl_m is None:
        return after
    innovation = z.h_amsl_m - h_autopilot_amsl_m - belief.height_offset_m
    s2 = belief.height_var_m2 + z.sigma_h_m**2
    if innovation**2 > HEIGHT_GATE_SIGMA**2 * s2:
        return after
    gain = belief.height_var_m2 / s2
    return replace(
        after, height_offset_m=belief.height_offset_m + gain * innovation, height_var_m2=(1 - gain) * belief.height_var_m2
    )
