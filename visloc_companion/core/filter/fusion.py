"""One step of the position filter as a pure function: belief and input in, belief out. The log and rewind: estimator.py.

State and process: propagation.py. The velocity that drives the filter is an input, never a measurement; its error is a state.
While an autopilot's velocity descends from our own fixes (`FED_BACK`), correcting it by a learned error and injecting the result
would feed the correction back into its own source and run away, so the error is then only considered (Schmidt), never
estimated, and grows with the time since the last fix and with what rare fixes tell of it (fed_back.py). A velocity integrated
from accelerations (`INERTIAL`) is fed by us through the attitude alone: its error, and that of the acceleration, are learned from
fixes and odometry whatever is injected, and each correction makes the latter less known. What a wrong lens does to fixes is
learned while the autopilot's velocity rests on GNSS, and considered from then on: a filter that learned it from fixes alone would
take a rolling shutter for it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from visloc_companion.core import kalman
from visloc_companion.core.filter import (
    alike,
    by_gnss,
    claims,
    contradiction,
    fed_back,
    lasting,
    lean,
    refused,
    relocalise,
    separation,
    votes,
)
from visloc_companion.core.filter.belief import NEVER_OFF, Belief, Position, driven_by, renewed, widened, widened_by
from visloc_companion.core.filter.propagation import (
    ACCELERATION,
    H_POSITION,
    HEADING,
    MOUNTING,
    N_CONSIDERED,
    N_STATES,
    POSITION,
    VELOCITY,
    Drive,
    step,
)
from visloc_companion.core.settings import InjectionSettings, NavigatorSettings
from visloc_companion.errors import Reason
from visloc_companion.types import Accepted, FloatArray, Rejected, Vec2

CONSIDERED = {Drive.AUTOPILOT: 0, Drive.NONE: 1, Drive.INERTIAL: 1, Drive.FED_BACK: N_CONSIDERED}
"""So many of the last states are not learned from positions; the lens of fixes is the very last."""
UNAIDED_SIGMA_MPS = 3.0
"""1-sigma of the velocity error where no velocity arrived for UNAIDED_GAP_S, or the autopilot itself does not trust it."""
INERTIAL_DRIFT_MPS2 = 0.03
"""Growth of that sigma while the velocity rests on our own dead reckoning only."""
ORDINARY_NIS = 6.0
"""A normalised squared innovation that one position in 20 exceeds. Beyond it, up to the gate, it is rather wrong than unlikely:
its covariance is raised until it would be ordinary, so that it hardly moves the velocity. Where the filter is far less sure than
a fix, and another one said the same, the filter is what is wrong, and its covariance is raised so."""
TILT_MPS2_PER_M = 0.15
"""While we inject, a correction of our position tilts the autopilot's attitude, by which accelerations are turned: so much
acceleration for a metre, three times what ArduCopter shows (docs/decisions/0021-corrections-tilt-the-autopilot.md)."""
UNIT = np.eye(2)
"""(2, 2); it is never changed."""
MAX_STEP_M = InjectionSettings().max_step_m
"""Where nothing else is configured. Larger corrections are sent as resets, which leave the autopilot's attitude as it was."""


def with_velocity_trust(belief: Belief, sigma_mps: float, drive: Drive) -> Belief:
    """Account for a change of how far the autopilot's velocity is to be believed, or of what it rests on.

    The latter makes it another velocity, whose error starts anew. A larger sigma takes effect at once; a smaller one over the
    correlation time.
    """
    over = belief.fed_back_over if drive is Drive.FED_BACK else 1.0
    if drive is not belief.drive:
        other = driven_by(belief, drive, over * max(sigma_mps, belief.sigma_v_mps) ** 2)
        return other._replace(sigma_v_mps=sigma_mps)
    if sigma_mps > belief.sigma_v_mps:
        return widened(belief, 0.0, over * (sigma_mps**2 - belief.sigma_v_mps**2))._replace(sigma_v_mps=sigma_mps)
    return belief if sigma_mps == belief.sigma_v_mps else belief._replace(sigma_v_mps=sigma_mps)


def with_inertial_velocity(belief: Belief, sigma_a_mps2: float, more_heading_rad2: float = 0.0) -> Belief:
    """Account for an inertial velocity, which begins with the autopilot's: that error goes on.

    `sigma_a_mps2`: 1-sigma of the slow error of its accelerations; `more_heading_rad2`: by how much the variance of the heading
    that turns them has grown.
    """
    if belief.drive is not Drive.INERTIAL:
        belief = renewed(belief, ACCELERATION, sigma_a_mps2**2)._replace(drive=Drive.INERTIAL)
    if more_heading_rad2 > 0:
        more = np.zeros((N_STATES, N_STATES))
        more[HEADING, HEADING] = more_heading_rad2
        belief = widened_by(belief, more)
    return belief if sigma_a_mps2 == belief.sigma_a_mps2 else belief._replace(sigma_a_mps2=sigma_a_mps2)


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
    gone_by = math.hypot(*v_ne_mps) * dt / belief.apart_m
    on = step(dt, belief.drive, belief.sigma_a_mps2, change_ne_mps, settings, gone_by, belief.lens_share)
    north, east = v_ne_mps[0] * dt, v_ne_mps[1] * dt
    moved = np.zeros(N_STATES)
    moved[0], moved[1] = north, east
    sigma_mps, Q = _sigma_mps(belief, settings), on.Q
    if belief.drive is not Drive.INERTIAL:
        Q += sigma_mps**2 * on.V  # the step is this belief's own
    F = on.F
    x = F.dot(belief.x)
    x += moved
    P = F.dot(belief.P).dot(F.T)
    P += Q  # kalman.update checks it
    without = separation.NONE if alone else belief.without
    if len(without.leaves):
        without = separation.propagated(without, on, Q, _more_m2ps2(belief, sigma_mps, settings), moved)
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
        belief.started_ns,
        belief.last_fix_ns,
        belief.rejected,
        belief.votes,
        without,
        belief.lean,
        belief.apart_m,
        belief.fix_per_m2,
        belief.fix_every_s,
        belief.former,
        belief.doubt,
        belief.claims,
        belief.fed_back_over,
        belief.lens_share,
        belief.contradicting,
        NEVER_OFF if alone else alike.carried(belief.alike, F),
        belief.headings_rad,
        belief.mounting_rad,
    )


def taken(
    belief: Belief, z: FloatArray, R: FloatArray, H: FloatArray, gate_sigma: float = math.inf
) -> tuple[Belief, Accepted | Rejected]:
    """The belief after a measurement z (2,), R (2, 2) of H x, H (2, 17), that is no fix: every solution takes it, too."""
    considered = min(1, CONSIDERED[belief.drive])
    got = kalman.update(belief.x, belief.P, z, R, H, gate_sigma=gate_sigma, n_considered=considered)
    if isinstance(got, Rejected):
        return belief, got
    every = np.ones(len(belief.without), np.bool_)
    without = separation.updated(belief.without, z, R, H, take=every, n_considered=considered)
    same = belief.alike
    if len(same):
        same = alike.measured(same, got.innovation, got.seen + R, H, kalman.gain(belief.P, R, H, considered))
    return belief._replace(x=got.x, P=got.P, without=without, alike=same), Accepted(got.nis)


def _sigma_mps(belief: Belief, settings: NavigatorSettings) -> float:
    """1-sigma of the velocity's error; an inertial velocity does without it."""
    sigma_mps = belief.sigma_v_mps
    if belief.drive is Drive.INERTIAL:
        return sigma_mps
    if belief.drive is not Drive.FED_BACK:  # a large learned error does not relax to zero as the model says: allow for that
        return max(sigma_mps, math.hypot(*belief.x[VELOCITY].tolist()) / 2)
    unheld_s = max(0.0, (belief.t_ns - belief.rested_ns) * 1e-9 - settings.dead_reckoning_after_s)
    return (sigma_mps + INERTIAL_DRIFT_MPS2 * unheld_s) * math.sqrt(belief.fed_back_over)


def _more_m2ps2(belief: Belief, sigma_mps: float, settings: NavigatorSettings) -> FloatArray | None:
    """By how much the variance (K,) of that error is larger in the solutions that leave fixes out than in the filter, which has
    `sigma_mps`; None where it is in none."""
    without, own_mps = belief.without, belief.sigma_v_mps
    if belief.drive is Drive.INERTIAL:
        return None
    if belief.drive is not Drive.FED_BACK:
        north_mps, east_mps = without.x[:, VELOCITY.start], without.x[:, VELOCITY.stop - 1]
        squared = (north_mps * north_mps + east_mps * east_mps) / 4
        return np.asarray(np.maximum(squared, own_mps**2) - sigma_mps**2)
    held_until_ns = belief.t_ns - round(settings.dead_reckoning_after_s * 1e9)
    unheld_ns = held_until_ns - np.maximum(without.rested_ns, belief.started_ns)
    drift_mps = INERTIAL_DRIFT_MPS2 * 1e-9 * np.maximum(unheld_ns, 0)
    more: FloatArray = drift_mps * (drift_mps + 2 * own_mps)  # (own + drift)^2 - own^2
    if belief.fed_back_over != 1.0:  # as it mostly is
        more *= belief.fed_back_over
    more += belief.fed_back_over * own_mps**2 - sigma_mps**2
    return more


def observed(
    belief: Belief, z: Position, settings: NavigatorSettings, max_step_m: float = MAX_STEP_M
) -> tuple[Belief, Accepted | Rejected]:
    """The belief after a position at its own time. Rejected fixes that agree with each other restart it at last. One that would
    carry it far, and further than it knows to have drifted, is rejected until another one says the same.

    `max_step_m`: larger corrections reach the autopilot as resets (`injection.max_step_m`).
    """
    considered = CONSIDERED[belief.drive]
    belief = by_gnss.looked(belief, z.heading_rad, z.mounting_rad)
    at, cov = np.array(z.p_ne_m), np.array(z.cov_ne_m2)
    if z.from_fix:
        cov = claims.over(belief.claims, z.method) * cov
    known, H, R = belief, H_POSITION, cov
    if z.from_fix:
        belief = _knowing(belief, z.mounting_rad)
        H, R = lasting.seen(cov, z.method, z.per_focal_ne_m, z.mounting)
    extra_m2 = settings.map_sigma_m**2 + (lasting.known_m2(belief.P, H) if z.from_fix else 0.0)
    got = kalman.update(
        belief.x,
        belief.P,
        at,
        R,
        H,
        gate_sigma=settings.gate_sigma,
        gate_extra_m2=extra_m2,
        n_considered=considered,
    )
    surprises = isinstance(got, kalman.Updated) and got.nis > ORDINARY_NIS
    drifted = surprises and z.from_fix and refused.far(belief, cov)
    if drifted and not refused.repeated(belief, z, settings):
        drifted = False
        got = Rejected(Reason.GATED, got.nis) if refused.soon_another(belief) else got
    if isinstance(got, kalman.Updated):
        off_m, seen_m2 = got.innovation, got.seen
        S = seen_m2 + R + extra_m2 * UNIT
        if z.from_fix:
            white_ne = lean.whitened(off_m, S)
            belief = belief._replace(
                claims=claims.learned(belief.claims, z.method, white_ne, _apart(belief, z), belief.sigma_v_mps)
            )
        before, innovation_m2 = belief, seen_m2 + R
        if surprises:
            more_m2 = (got.nis / ORDINARY_NIS - 1) * S
            innovation_m2 = innovation_m2 + more_m2
            before, R = (refused.drifted(belief, more_m2), R) if drifted else (belief, R + more_m2)
            anew = kalman.update(before.x, before.P, at, R, H, n_considered=considered)
            got = replace(anew, nis=got.nis) if isinstance(anew, kalman.Updated) else anew
    if isinstance(got, kalman.Updated):
        without, same = _others(belief, z, R, H, considered), belief.alike
        if z.from_fix or len(same):
            same = _alike(belief, got, z, R, H, kalman.gain(before.P, R, H, considered))
        after = _tilted(belief._replace(x=got.x, P=got.P, without=without, alike=same), before, max_step_m)
        after = _suspected(after, belief, z, got.nis / 2, innovation_m2)
        if not z.from_fix:
            return after, Accepted(got.nis)
        if drifted or not surprises:
            after = _agreed(after, z)
        return _leant(_fixed(after, z), belief.lean, off_m, innovation_m2), Accepted(got.nis)
    if not z.from_fix or got.reason is not Reason.GATED:
        return known, got
    belief = refused.remembering(known, z)
    restart = relocalise.restart(belief.rejected, belief.sigma_v_mps, settings)
    if restart is None:
        return refused.doubting(belief, z), got
    return _fixed(_agreed(refused.restarted(belief, z, restart, settings), z), z), Accepted(got.nis)


def _knowing(belief: Belief, mounting_rad: float) -> Belief:
    """The belief with what the mounting has of fixes in 1-sigmas of what is known of it now."""
    if mounting_rad in (0.0, belief.mounting_rad):
        return belief
    kept = lasting.learned(belief.mounting_rad, mounting_rad)
    F, Q = np.eye(N_STATES), np.zeros((N_STATES, N_STATES))
    F[MOUNTING, MOUNTING], Q[MOUNTING, MOUNTING] = kept * UNIT, (1 - kept * kept) * UNIT
    x, P, same = F.dot(belief.x), F.dot(belief.P).dot(F.T) + Q, alike.carried(belief.alike, F)
    return belief._replace(x=x, P=P, without=separation.carried(belief.without, F, Q), alike=same, mounting_rad=mounting_rad)


def _apart(belief: Belief, z: Position) -> claims.Apart:
    """Where a fix has the vehicle, less its motion."""
    at_ne_m = z.p_ne_m[0] - belief.moved_ne_m[0], z.p_ne_m[1] - belief.moved_ne_m[1]
    return claims.Apart(at_ne_m, z.t_ns, (z.cov_ne_m2[0][0] + z.cov_ne_m2[1][1]) / 2)


def _suspected(after: Belief, before: Belief, z: Position, squared: float, S: FloatArray) -> Belief:
    """With the variance of a fed-back velocity that a fix tells; `squared`: its normalised squared innovation over its degrees of
    freedom, S (2, 2) the innovation's covariance."""
    if before.drive is not Drive.FED_BACK or not z.from_fix:
        return after
    since_ns = max(before.rested_ns, before.started_ns if before.former is None else before.former.until_ns)
    over = fed_back.learned(before.fed_back_over, squared, before.P, S, (z.t_ns - since_ns) * 1e-9)
    if over == after.fed_back_over:
        return after
    more = max(0.0, over - before.fed_back_over) * before.sigma_v_mps**2
    return (widened(after, 0.0, more) if more else after)._replace(fed_back_over=over)


def _tilted(after: Belief, before: Belief, max_step_m: float) -> Belief:
    """With the error of the accelerations that the correction just made will come back as.

    Its covariance is that of the correction, P before less P after, as far as that is no reset of more than `max_step_m`.
    Every solution reckons with the same accelerations.
    """
    if before.drive is not Drive.INERTIAL:
        return after
    corrected_m2 = (before.P - after.P)[POSITION, POSITION]
    tilting = max_step_m**2 / max(max_step_m**2, float(np.linalg.norm(corrected_m2, 2)))
    more = np.zeros((N_STATES, N_STATES))
    more[ACCELERATION, ACCELERATION] = TILT_MPS2_PER_M**2 * tilting * corrected_m2
    return widened_by(after, more)


def _leant(after: Belief, before_ne: Vec2, off_m: FloatArray, S: FloatArray) -> Belief:
    """Where fixes lean to one side, odometry is doubted. The lean before, an innovation (2,) and its covariance (2, 2)."""
    mean = lean.leaning(before_ne, lean.whitened(off_m, S))
    if not lean.leans(mean):
        return after._replace(lean=mean)
    return widened_by(after, lean.DOUBT)._replace(lean=lean.UPRIGHT)


def _others(belief: Belief, z: Position, R: FloatArray, H: FloatArray, n_considered: int) -> separation.Solutions:
    """The solutions that leave fixes out, after a position that the filter took."""
    among = belief.without
    take = ~separation.leaving_out(among, z.method) if z.from_fix else np.ones(len(among), np.bool_)
    at, rests_ns = np.array(z.p_ne_m), z.t_ns if z.from_fix else None
    among = separation.updated(among, at, R, H, take=take, n_considered=n_considered, t_ns=rests_ns)
    return refused.founded(belief, z, among) if z.from_fix else among


def _alike(belief: Belief, got: kalman.Updated, z: Position, R: FloatArray, H: FloatArray, gain: FloatArray) -> alike.Alike:
    """What the filter is off by if fixes are wrong alike, after a position that it took with this gain (17, 2)."""
    again = votes.errs_again(belief.votes, z.method, z.looks_at_ne_m(belief.x[POSITION]), z.spacing_m) if z.from_fix else 1.0
    taken = alike.Taken(z.t_ns, z.method, z.probability_wrong, again, got.innovation, got.seen + R, H, gain)
    return (alike.after_fix if z.from_fix else alike.after_other)(belief.alike, taken)


def _agreed(belief: Belief, z: Position) -> Belief:
    if not belief.contradicting:
        return belief
    return belief._replace(contradicting=contradiction.agreed(belief.contradicting, z.method))


def _fixed(belief: Belief, z: Position) -> Belief:
    looks_at_ne_m = z.looks_at_ne_m(belief.x[POSITION])
    voted = votes.voted(belief.votes, z.method, z.t_ns, looks_at_ne_m, z.spacing_m)
    without = separation.apart(belief.without, belief.x, belief.P)
    after = belief.after_fix(z.t_ns, (z.cov_ne_m2[0][0] + z.cov_ne_m2[1][1]) / 2)
    return by_gnss.kept(after._replace(rejected=(), votes=voted, without=without, apart_m=z.apart_m))
