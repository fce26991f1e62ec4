"""One step of the position filter as a pure function: belief and input in, belief out. The log and rewind: estimator.py.

State (4,): horizontal position north, east at the EKF origin, and the error of the autopilot's velocity (its velocity minus
the true one), first-order Gauss-Markov. The autopilot's velocity is an input, never a measurement. While we inject, that
velocity descends from our own fixes (`feedback`): correcting it by a learned error and injecting the result would feed the
correction back into its own source and run away, so the error is then only considered (Schmidt), never estimated, and grows
with the time since the last fix, as an inertial solution that nothing else holds does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from visloc_companion.core import kalman, relocalise, separation
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.errors import Reason
from visloc_companion.types import Accepted, Cov2, FloatArray, Rejected, Vec2

H_POSITION: FloatArray = np.eye(2, 4)
WALK_M_PER_SQRT_S = 0.05
"""Random walk of the integration itself (time stamps, rounding of the velocity messages)."""
UNAIDED_GAP_S = 1.0
UNAIDED_SIGMA_MPS = 3.0
"""1-sigma of the velocity error where no velocity arrived for UNAIDED_GAP_S, or the autopilot itself does not trust it."""
INERTIAL_DRIFT_MPS2 = 0.03
"""Growth of that sigma while the velocity rests on our own dead reckoning only."""
HEIGHT_WALK_M_PER_SQRT_S = 0.1
HEIGHT_GATE_SIGMA = 4.0
DOUBT_AFTER = 2
DOUBT_MPS = 4.0
MAX_DOUBT_MPS = 12.0
"""Added 1-sigma of the velocity error for each rejection from the second on, and where that ends."""
RECENT_S = 30.0
"""Methods whose fixes are no older than this are votes beside each other."""


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """The filter at `t_ns`: mean x (4,), covariance P (4, 4), the integral of the velocity input, and its memory.

    `votes`: each method with the time of its last fix; `without`: the solutions that leave fixes out (separation.py).
    """

    t_ns: int
    x: FloatArray
    P: FloatArray
    sigma_v_mps: float
    feedback: bool
    travel_ne_m: Vec2
    height_offset_m: float
    height_var_m2: float
    started_ns: int
    last_fix_ns: int | None = None
    rejected: tuple[relocalise.Candidate, ...] = ()
    votes: tuple[tuple[str, int], ...] = ()
    without: separation.Solutions = separation.NONE


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


def seeded(t_ns: int, p_ne_m: Vec2, sigma_m: float, sigma_v_mps: float, feedback: bool, sigma_h_m: float) -> Belief:
    """A belief that starts from one position."""
    P = np.diag([sigma_m**2, sigma_m**2, sigma_v_mps**2, sigma_v_mps**2])
    x = np.array([p_ne_m[0], p_ne_m[1], 0.0, 0.0])
    return Belief(t_ns, x, P, sigma_v_mps, feedback, (0.0, 0.0), 0.0, sigma_h_m**2, t_ns)


def with_velocity_trust(belief: Belief, sigma_mps: float, feedback: bool) -> Belief:
    """Account for a change of where the velocity comes from.

    A change of `feedback` makes it another velocity: its error starts anew. A larger sigma takes effect at once; a smaller
    one over the correlation time.
    """
    if feedback != belief.feedback:
        x, P = belief.x.copy(), belief.P.copy()
        x[2:], P[2:, :2], P[:2, 2:] = 0.0, 0.0, 0.0
        variance = max(sigma_mps, belief.sigma_v_mps) ** 2
        P[2:, 2:] = np.eye(2) * variance
        without = separation.with_new_velocity(belief.without, variance)
        return replace(belief, x=x, P=P, sigma_v_mps=sigma_mps, feedback=feedback, without=without)
    if sigma_mps > belief.sigma_v_mps:
        return replace(widened(belief, 0.0, sigma_mps**2 - belief.sigma_v_mps**2), sigma_v_mps=sigma_mps)
    return belief if sigma_mps == belief.sigma_v_mps else replace(belief, sigma_v_mps=sigma_mps)


def propagated(belief: Belief, t_ns: int, v_ne_mps: Vec2, settings: NavigatorSettings) -> Belief:
    """The belief carried to a later time by a mean velocity; exact for any division of the interval.

    Discretisation of the integrated Gauss-Markov process in closed form (e.g. Brown & Hwang, section 5.3).
    """
    dt = (t_ns - belief.t_ns) * 1e-9
    if dt <= 0:
        return belief
    F, Q = _transition(dt, settings.velocity_correlation_s, np.array([_effective_sigma_mps(belief, settings)]))
    moved = (v_ne_mps[0] * dt, v_ne_mps[1] * dt)
    step = np.array([*moved, 0.0, 0.0])
    x, P = kalman.predict(belief.x, belief.P, F, Q[0], step)
    without = belief.without
    if len(without):
        sigmas = _sigmas_mps(belief, without.x, without.rested_ns, settings)
        without = separation.propagated(without, F, _transition(dt, settings.velocity_correlation_s, sigmas)[1], step)
    travel = (belief.travel_ne_m[0] + moved[0], belief.travel_ne_m[1] + moved[1])
    height_var = belief.height_var_m2 + HEIGHT_WALK_M_PER_SQRT_S**2 * dt
    return replace(belief, t_ns=t_ns, x=x, P=P, travel_ne_m=travel, height_var_m2=height_var, without=without)


def _transition(dt_s: float, tau_s: float, sigma_mps: FloatArray) -> tuple[FloatArray, FloatArray]:
    """F (4, 4), and Q (K, 4, 4) for K sigmas of the velocity's error."""
    a = math.exp(-dt_s / tau_s)
    variance = np.square(sigma_mps)
    blocks = np.empty((len(variance), 2, 2))
    blocks[:, 1, 1] = variance * (1 - a * a)
    blocks[:, 0, 1] = blocks[:, 1, 0] = -variance * tau_s * (1 - a) ** 2
    blocks[:, 0, 0] = variance * tau_s**2 * _integrated(dt_s / tau_s) + WALK_M_PER_SQRT_S**2 * dt_s
    F = np.asarray(np.kron(np.array([[1.0, -tau_s * (1 - a)], [0.0, a]]), np.eye(2)), dtype=np.float64)
    return F, np.asarray(np.kron(blocks, np.eye(2)), dtype=np.float64)


def blurred(belief: Belief, sigma_m: float) -> Belief:
    """The belief with an independent position error added."""
    return widened(belief, sigma_m**2, 0.0)


def widened(belief: Belief, position_m2: float, velocity_m2ps2: float) -> Belief:
    """The belief with independent errors of position and of the velocity's error added, on each axis."""
    more = np.diag([position_m2, position_m2, velocity_m2ps2, velocity_m2ps2])
    return replace(belief, P=belief.P + more, without=separation.widened(belief.without, more))


def _integrated(spread: float) -> float:
    """2 s - 3 + 4 exp(-s) - exp(-2 s), by its series where that cancels."""
    if spread < 0.01:
        return spread**3 * (2 / 3 - spread / 2 + 7 * spread**2 / 30)
    return 2 * spread - 3 + 4 * math.exp(-spread) - math.exp(-2 * spread)


def _effective_sigma_mps(belief: Belief, settings: NavigatorSettings) -> float:
    rested_ns = belief.started_ns if belief.last_fix_ns is None else belief.last_fix_ns
    return float(_sigmas_mps(belief, belief.x[None], np.array([rested_ns]), settings)[0])


def _sigmas_mps(belief: Belief, x: FloatArray, rested_ns: NDArray[np.int64], settings: NavigatorSettings) -> FloatArray:
    """1-sigma (K,) of the velocity's error of solutions x (K, 4) that rest on fixes of these times (K,)."""
    if not belief.feedback:  # a large learned error does not relax to zero as the model says: allow for that
        return np.asarray(np.maximum(belief.sigma_v_mps, np.hypot(x[:, 2], x[:, 3]) / 2))
    rested_s = (belief.t_ns - np.maximum(rested_ns, belief.started_ns)) * 1e-9
    alone_s = np.maximum(0.0, rested_s - settings.dead_reckoning_after_s)
    return np.asarray(belief.sigma_v_mps + INERTIAL_DRIFT_MPS2 * alone_s)


def observed(
    belief: Belief, z: Position, h_autopilot_amsl_m: float | None, settings: NavigatorSettings
) -> tuple[Belief, Accepted | Rejected]:
    """The belief after a position at its own time. Rejected fixes that agree with each other restart it at last."""
    considered = 2 if belief.feedback else 0
    got = kalman.update(
        belief.x,
        belief.P,
        np.array(z.p_ne_m),
        np.array(z.cov_ne_m2),
        H_POSITION,
        gate_sigma=settings.gate_sigma,
        gate_extra_m2=settings.map_sigma_m**2,
        n_considered=considered,
    )
    if isinstance(got, kalman.Updated):
        after = replace(belief, x=got.x, P=got.P, without=_others(belief, z, considered))
        return (_fixed(after, z, h_autopilot_amsl_m) if z.from_fix else after), Accepted(got.nis)
    if not z.from_fix or got.reason is not Reason.GATED:
        return belief, got
    belief = _remembering(belief, z)
    restart = relocalise.restart(belief.rejected, belief.sigma_v_mps, settings)
    if restart is None:
        return _doubting(belief, z), got
    return _fixed(_restarted(belief, z, restart, settings), z, h_autopilot_amsl_m), Accepted(got.nis)


def _others(belief: Belief, z: Position, n_considered: int) -> separation.Solutions:
    """The solutions that leave fixes out, after a position that the filter took."""
    among = belief.without
    take = ~separation.leaving_out(among, z.method) if z.from_fix else np.ones(len(among), np.bool_)
    at, cov, rests_ns = np.array(z.p_ne_m), np.array(z.cov_ne_m2), z.t_ns if z.from_fix else None
    among = separation.updated(among, at, cov, take=take, n_considered=n_considered, t_ns=rests_ns)
    return _founded(belief, z, among) if z.from_fix else among


def _founded(belief: Belief, z: Position, among: separation.Solutions) -> separation.Solutions:
    rested_ns = belief.started_ns if belief.last_fix_ns is None else belief.last_fix_ns
    recent = frozenset(method for method, t_ns in belief.votes if z.t_ns - t_ns <= RECENT_S * 1e9)
    return separation.without_fix(among, z.method, z.probability_wrong, (belief.x, belief.P, rested_ns), recent)


def _remembering(belief: Belief, z: Position) -> Belief:
    anchor = (z.p_ne_m[0] - belief.travel_ne_m[0], z.p_ne_m[1] - belief.travel_ne_m[1])
    new = relocalise.Candidate(z.t_ns, z.p_ne_m, anchor, z.cov_ne_m2)
    return replace(belief, rejected=relocalise.remembered(belief.rejected, new))


def _doubting(belief: Belief, z: Position) -> Belief:
    """After repeated rejections that a wrong velocity could explain: doubt the velocity, so that the search region follows.

    A false velocity (GNSS velocity is spoofed, too) otherwise carries the filter away from the fixes that contradict it.
    """
    rested_ns = belief.started_ns if belief.last_fix_ns is None else belief.last_fix_ns
    off_m = math.hypot(z.p_ne_m[0] - float(belief.x[0]), z.p_ne_m[1] - float(belief.x[1]))
    explained = off_m <= relocalise.MAX_VELOCITY_ERROR_MPS * (z.t_ns - rested_ns) * 1e-9
    doubtful = len(belief.rejected) >= DOUBT_AFTER and explained and not relocalise.standing(belief.rejected)
    if not doubtful or float(belief.P[2, 2]) > MAX_DOUBT_MPS**2:
        return belief
    return widened(belief, 0.0, DOUBT_MPS**2)


def _restarted(belief: Belief, z: Position, found: relocalise.Restart, settings: NavigatorSettings) -> Belief:
    """From the last of the agreeing fixes, with its own covariance: their errors may be one error, so nothing is averaged."""
    sigma_v = max(belief.sigma_v_mps, settings.velocity_sigma_aiding_mps, found.sigma_mps)
    error = found.velocity_error_ne_mps
    if belief.feedback:
        sigma_v, error = max(sigma_v, math.hypot(*error)), (0.0, 0.0)
    P = np.zeros((4, 4))
    P[:2, :2], P[2:, 2:] = np.array(z.cov_ne_m2), np.eye(2) * sigma_v**2
    without = _founded(belief, z, belief.without)
    return replace(belief, x=np.array([*z.p_ne_m, *error]), P=P, started_ns=z.t_ns, without=without)


def _fixed(belief: Belief, z: Position, h_autopilot_amsl_m: float | None) -> Belief:
    votes = (*((method, t_ns) for method, t_ns in belief.votes if method != z.method), (z.method, z.t_ns))
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
