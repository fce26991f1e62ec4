"""What fixes tell of the camera's tilt, kept from frame to frame.

A frame hardly tells a tilt from a step to the side, so that the tilt's prior decides most of a fix's error. How the camera is
mounted stays as it is and the autopilot's attitude errs for seconds, so what earlier frames saw of both is worth more than to
begin anew in each. A Kalman filter of eight: mounting about the vehicle's forward and right axes, attitude about north and east,
what neighbouring fixes get wrong in common about north and east (in 1-sigmas of it), and what the attitude's error was when the
kept frame was taken.

Pictures also show how the camera turned from frame to frame (Turn). Against the change of the reported attitude that is by how
much its error has changed: what is known of one frame holds for the next, however poor the gyroscopes are. How fast that error
wanders is learned from the same turns. Turns that follow each other add their errors up; those since one frame that is kept for
seconds do not (a cloned state). A wrong lens makes all turns too large alike: each by itself is no less certain for it.

Neighbouring frames see the same trees grown and felled since the map was made, and take them for the same tilt. That error goes
by with the way over the ground, as that of their places does (lasting.py): many fixes of one place tell little more than one, and
one that is sure of an attitude that has just gone wrong is believed at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from visloc_companion.core.filter.lasting import SHARE, apart_m, root_m
from visloc_companion.core.remembered import remember
from visloc_companion.geo import se3
from visloc_companion.geo.tilt import CAMERA_SIGMA, LAND_RAD, by_camera, composed, tilt_gained
from visloc_companion.types import Fix, FloatArray, LocaliseRequest, Quat, TiltBefore, TiltPrior, TiltSeen, Turn, Vec2

MOUNTING, ATTITUDE, IN_COMMON, KEPT, CAMERA = (slice(k, k + 2) for k in (0, 2, 4, 6, 8))
TILT, STATES = slice(0, 4), 10
UNIT = np.eye(2)
"""It is never changed."""
ATTITUDE_SIGMA_RAD, ATTITUDE_S = math.radians(0.4), 20.0
"""Of the autopilot's tilt, Gauss-Markov: ArduCopter's simulator shows 0.1 degrees with GNSS and 0.2 to 0.4 on vision, where it is
calm."""
LEAST_HASTE = 2.0
"""It is never believed to wander more slowly than so many times that: turns shrunk by a belief in calm are lost for good."""
CHANGED_RAD = math.radians(0.3)
"""1-sigma of what changes of the ground add to a tilt that is seen, all of it in common; no frame knows of it."""
ORDINARY_NIS = 3.0
"""Where a measurement is further from what is known (2 is the mean), one of the two was surer of itself than it should: a fix is
believed less by as much; between a turn and the attitude's model it is shared, for autopilots correct their attitude in steps."""
SURE = 0.05
GATE_SIGMA, GATED_IN_A_ROW = 4.0, 8
"""So many fixes in a row beyond the gate: the camera was knocked, and all begins anew."""
FRAMES_KEPT = 4
WIDEST_RAD = math.radians(2.0)
"""Of an attitude whose error is seen to wander: an autopilot with poor gyroscopes errs by more than anybody states of it."""
NEIGHBOURS, OF_ONE_FRAME = 4.0, 9.0
"""Turns that follow each other err the same way for a second or two: forty together by twice what forty would that err anew each;
and those since one kept frame err alike. Factors of their covariances."""
MOST_STEP_RAD = math.radians(2.0)
"""No autopilot corrects its attitude by more within a turn: the turn is wrong."""
RATE_S = 1.0
"""Turns are added up for so long to see how fast the attitude's error wanders: it goes on for seconds, each turn errs anew. An
autopilot that follows our positions swings like a pendulum; who sees that late swings with it."""
RATE_WEIGHT = 0.3
"""Of the latest stretch in the mean rate."""
MOST_NEWS = 20.0
"""A single stretch is no more than so many times what is believed of that rate."""


@dataclass(frozen=True, slots=True)
class _Stretch:
    """Turns that follow each other, as one, and the attitude that was reported where it begins."""

    turn: Turn
    q_before: Quat


class Told(NamedTuple):
    """Of the tilt of a fix, as it is known with what that fix sees: what it errs by the mounting, 1-sigma on each axis (rad),
    which is little where the picture tells the tilt, for the attitude is then held to err by as much the other way; by how much
    the variance on each axis is larger than its localiser can know (rad²), which takes the slope of the ground in view for news,
    though earlier fixes took the same slope for a tilt; and the rotation about north and east (rad) that sets right what it
    made of that, where it did not know how the ground slopes."""

    mounting_rad: float
    more_rad2: float
    turn_ne_rad: Vec2


NOTHING_TOLD = Told(0.0, 0.0, (0.0, 0.0))


class _Asked(NamedTuple):
    """Of a request: what is seen of mounting and attitude (2, 4), and the tilt that it tells, rad, with its variance, rad²."""

    H: FloatArray
    turn_ne_rad: Vec2
    told_rad2: float


class _Seen(NamedTuple):
    """Mean (10,) and covariance (10, 10) when a fix saw the tilt, what it saw of them (2, 10), and what is new in it (2, 2)."""

    x: FloatArray
    P: FloatArray
    H: FloatArray
    R: FloatArray

    def learnt(self, turn_ne_rad: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Mean and covariance with the tilt (2,) that the fix saw; None where that is beyond the gate."""
        x, P, H, R = self
        nu, S = turn_ne_rad - H @ x, H @ P @ H.T + R
        nis = float(nu @ np.linalg.solve(S, nu))
        return None if nis > GATE_SIGMA**2 else _learnt(x, P, H, nu, R + _unexpected(nis, S))


class TiltMemory:
    """`known` is for the next request's prior; the others learn. `sigma_rad`: 1-sigma of mounting and attitude together."""

    def __init__(self, sigma_rad: float) -> None:
        self._attitude_rad = min(ATTITUDE_SIGMA_RAD, sigma_rad / 2)
        self._mounting_rad = math.sqrt(sigma_rad**2 - self._attitude_rad**2)
        self._least_rate = self._rate = LEAST_HASTE * 2 * self._attitude_rad**2 / ATTITUDE_S
        self._stretch: _Stretch | None = None
        self._asked: dict[int, _Asked] = {}
        self._frames: dict[int, tuple[Quat, FloatArray]] = {}
        self._begin()

    def _begin(self) -> None:
        self._x = np.zeros(STATES)
        mounting, attitude = [self._mounting_rad] * 2, [self._attitude_rad] * 2
        self._P = np.diag(np.square([*mounting, *attitude, 1.0, 1.0, *attitude, *CAMERA_SIGMA]))
        self._kept_frame: tuple[int, tuple[Quat, FloatArray]] | None = None
        self._t_ns: int | None = None
        self._fix_ns: int | None = None
        self._gated = 0

    def known(self, t_ns: int, q_ned_frd: Quat) -> TiltPrior | None:
        """What is known of the tilt at a time, at an attitude of the vehicle; None before anything was learned."""
        if self._t_ns is None:
            return None
        turn, sigma_rad = self._told(t_ns, _seen_of(se3.R_from_quat(q_ned_frd)))
        return TiltPrior(turn, sigma_rad, self._before())

    def _before(self) -> TiltBefore | None:
        """The same of the last frame that was asked about."""
        last_ns = next(reversed(self._frames), None)
        if last_ns is None:
            return None
        q_ned_cambody, H = self._frames[last_ns]
        return TiltBefore(last_ns, q_ned_cambody, *self._told(last_ns, H))

    def _told(self, t_ns: int, H: FloatArray) -> tuple[Vec2, float]:
        x, P = self._carried(t_ns)
        north, east = (H @ x[TILT]).tolist()
        return (north, east), math.sqrt(float(np.linalg.eigvalsh(H @ P[TILT, TILT] @ H.T)[-1]))

    def told(self, fix: Fix, v_ne_mps: Vec2, height_m: float) -> Told:
        """Of the tilt of a fix, at a velocity and a height above the ground, before it is taken; nothing of one that saw none."""
        asked = self._asked.get(fix.request_id)
        if asked is None or fix.tilt is None or height_m <= 0:
            return NOTHING_TOLD
        before = self._seen(fix, fix.tilt, asked.H, v_ne_mps, height_m)
        seen, blocks = np.array(fix.tilt.turn_ne_rad), np.array(fix.tilt.cov_rad2)
        kept = blocks @ np.linalg.inv(asked.told_rad2 * UNIT + blocks)  # of what was told; the rest is the picture's
        (errs_rad2, by_mounting), (north, east) = _by_localiser(before, kept), (0.0, 0.0)
        x, P = before.learnt(seen) or (before.x, before.P)
        if float(np.linalg.eigvalsh(blocks)[0]) >= LAND_RAD**2:  # whoever knows the surface sees more of a tilt, and errs anew
            north, east = (asked.H @ x[TILT] - kept @ asked.turn_ne_rad - (UNIT - kept) @ seen).tolist()
            errs_rad2, by_mounting = asked.H @ P[TILT, TILT] @ asked.H.T, 1.0
        more = float(np.trace(errs_rad2 - asked.told_rad2 * kept)) / 2
        mounting_rad2 = float(np.trace(P[MOUNTING, MOUNTING])) / 2
        return Told(by_mounting * math.sqrt(max(0.0, mounting_rad2)), max(0.0, more), (north, east))

    def asked(self, request: LocaliseRequest, q_ned_frd: Quat) -> None:
        """Remember the attitude of the vehicle, and that of the camera's body, that a request's prior has."""
        H = _seen_of(se3.R_from_quat(q_ned_frd))
        known = request.prior.tilt
        told_rad = request.prior.sigma_tilt_rad if known is None else known.sigma_rad
        turn_ne_rad = (0.0, 0.0) if known is None else known.turn_ne_rad
        remember(self._asked, request.request_id, _Asked(H, turn_ne_rad, told_rad**2))
        remember(self._frames, request.frame.t_ns, (request.prior.q_ned_frd, H), FRAMES_KEPT)

    def remounted(self, turn_rad: FloatArray) -> None:
        """Requests have a mounting from now on that is turned by this much (3,) about the vehicle's axes."""
        if np.any(turn_rad):
            self._frames.clear()
            self._kept_frame = None
        self._x[MOUNTING] -= turn_rad[:2]

    def turned(self, turn: Turn, since_kept: Turn | None = None) -> None:
        """Learn from how the camera turned between two frames that were asked about, and since one further back."""
        if turn.t_from_ns not in self._frames or turn.t_to_ns not in self._frames:
            return
        self._wandered(turn, self._frames[turn.t_from_ns][0], self._frames[turn.t_to_ns][0])
        if self._t_ns is None or self._t_ns > turn.t_from_ns:
            return
        if since_kept is not None and since_kept.t_from_ns == turn.t_from_ns:
            self._keep(turn.t_from_ns)
        self._gain(turn)
        if since_kept is not None and since_kept.t_from_ns < turn.t_from_ns:
            self._gain_since_kept(since_kept)

    def _wandered(self, turn: Turn, q_before: Quat, q_now: Quat) -> None:
        """Learn how fast the attitude's error wanders, from turns that follow each other."""
        last = self._stretch
        if last is not None and last.turn.t_to_ns == turn.t_from_ns:
            q_before, turn = last.q_before, composed(last.turn, turn)
        dt_s = (turn.t_to_ns - turn.t_from_ns) * 1e-9
        if dt_s < RATE_S:
            self._stretch = _Stretch(turn, q_before)
            return
        self._stretch = None
        gained, cov = tilt_gained(q_before, turn, q_now)
        news = max(0.0, float(gained @ gained - np.trace(cov)) / 2 / dt_s)
        self._rate += RATE_WEIGHT * (min(news, MOST_NEWS * self._rate) - self._rate)
        self._rate = max(self._rate, self._least_rate)

    def _gain(self, turn: Turn) -> None:
        """The change of the tilt, measured; of a turn that is wrong only time goes by."""
        before, now = self._frames[turn.t_from_ns], self._frames[turn.t_to_ns]
        gained, cov = tilt_gained(before[0], turn, now[0])
        x, P = self._carried(turn.t_from_ns)
        self._x, self._P, self._t_ns = x, P, turn.t_from_ns
        after_x, after_P = self._carried(turn.t_to_ns)
        across = P[:, ATTITUDE].copy()  # covariance of the state after with the attitude's error before
        across[ATTITUDE] *= self._kept(turn.t_to_ns)
        H = _changed(before, now)
        C = after_P @ H.T - across
        S = H @ C - (H @ across).T + P[ATTITUDE, ATTITUDE] + NEIGHBOURS * cov
        y = gained - (H @ after_x - x[ATTITUDE])
        if math.hypot(*y) <= MOST_STEP_RAD:
            more = _unexpected(float(y @ np.linalg.solve(S, y)), S)
            after_P[ATTITUDE, ATTITUDE] += more
            C[ATTITUDE] += more
            K = _weight(S + more, C)
            after_x, after_P = after_x + K @ y, after_P - K @ C.T - C @ K.T + K @ (S + more) @ K.T
        self._x, self._P, self._t_ns = after_x, (after_P + after_P.T) / 2, turn.t_to_ns

    def _keep(self, t_ns: int) -> None:
        """What the attitude's error is at this frame stays beside what it becomes."""
        self._x, self._P = self._carried(t_ns)
        self._t_ns, self._kept_frame = t_ns, (t_ns, self._frames[t_ns])
        self._x[KEPT] = self._x[ATTITUDE]
        self._P[KEPT] = self._P[ATTITUDE]
        self._P[:, KEPT] = self._P[:, ATTITUDE]

    def _gain_since_kept(self, turn: Turn) -> None:
        """The change since the kept frame, measured at once."""
        if self._kept_frame is None or self._kept_frame[0] != turn.t_from_ns or self._t_ns != turn.t_to_ns:
            return
        kept, now = self._kept_frame[1], self._frames[turn.t_to_ns]
        gained, cov = tilt_gained(kept[0], turn, now[0])
        H = _changed(kept, now)
        H[:, KEPT] = -np.eye(2)
        y, R = gained - H @ self._x, OF_ONE_FRAME * cov
        if math.hypot(*y) <= MOST_STEP_RAD:
            S = H @ self._P @ H.T + R
            R = R + _unexpected(float(y @ np.linalg.solve(S, y)), S)
            self._x, self._P = _learnt(self._x, self._P, H, y, R)

    def taken(self, fix: Fix, v_ne_mps: Vec2, height_m: float) -> None:
        """Learn from a fix that the filter took, at a velocity and a height above the ground."""
        asked = self._asked.pop(fix.request_id, None)
        if asked is None or fix.tilt is None or fix.probability_wrong > SURE or height_m <= 0:
            return
        learnt = self._seen(fix, fix.tilt, asked.H, v_ne_mps, height_m).learnt(np.array(fix.tilt.turn_ne_rad))
        if learnt is None:
            self._gated += 1
            if self._gated >= GATED_IN_A_ROW:
                self._begin()
            return
        self._gated = 0
        self._x, self._P = learnt
        self._fix_ns = fix.t_ns if self._fix_ns is None else max(self._fix_ns, fix.t_ns)
        self._t_ns = fix.t_ns if self._t_ns is None else max(self._t_ns, fix.t_ns)

    def _seen(self, fix: Fix, tilt: TiltSeen, H_tilt: FloatArray, v_ne_mps: Vec2, height_m: float) -> _Seen:
        x, P = self._carried(fix.t_ns)
        since_s = 0.0 if self._fix_ns is None else max(0.0, (fix.t_ns - self._fix_ns) * 1e-9)
        _forget(x, P, IN_COMMON, math.exp(-math.hypot(*v_ne_mps) * since_s / apart_m(height_m)), 1.0)
        cov = np.array(tilt.cov_rad2)
        in_common = root_m(cov + CHANGED_RAD**2 / SHARE * UNIT)  # the root is of SHARE of it
        return _Seen(x, P, np.hstack([H_tilt, in_common, np.zeros((2, STATES - KEPT.start))]), (1 - SHARE) * cov)

    def _carried(self, t_ns: int) -> tuple[FloatArray, FloatArray]:
        """Mean (10,) and covariance (10, 10) at a time."""
        x, P = self._x.copy(), self._P.copy()
        _forget(x, P, ATTITUDE, self._kept(t_ns), self._wander_rad2)
        return x, P

    @property
    def _wander_rad2(self) -> float:
        """Variance of the attitude's error on each axis: a calm one's, what its rate beyond the least believed comes to in
        ATTITUDE_S, and that of the error that is known: a large one is no calm attitude's, and stays for longer."""
        restless_rad2 = (self._rate - self._least_rate) * ATTITUDE_S / 2
        known_rad2 = float(np.vdot(self._x[ATTITUDE], self._x[ATTITUDE])) / 2
        return min(self._attitude_rad**2 + restless_rad2 + known_rad2, WIDEST_RAD**2)

    def _kept(self, t_ns: int) -> float:
        """The share of the attitude's error that is left at a time."""
        dt_s = 0.0 if self._t_ns is None else max(0.0, (t_ns - self._t_ns) * 1e-9)
        return math.exp(-dt_s * self._rate / (2 * self._wander_rad2))


def _forget(x: FloatArray, P: FloatArray, pair: slice, kept: float, variance: float) -> None:
    """A pair of states goes by to this share, towards zero and a variance of its own (Gauss-Markov), in place."""
    x[pair] *= kept
    P[pair, :] *= kept
    P[:, pair] *= kept
    for axis in range(pair.start, pair.stop):
        P[axis, axis] += (1 - kept**2) * variance


def _weight(S: FloatArray, C: FloatArray) -> FloatArray:
    """(10, 2) of an innovation of covariance S (2, 2), and C (10, 2) with the states. What is wrong with a camera is considered,
    not learned (Schmidt): an attitude that errs anew within seconds goes with the turns, as a wrong lens would have it."""
    K = np.linalg.solve(S, C.T).T
    K[CAMERA] = 0.0
    return np.asarray(K)


def _learnt(x: FloatArray, P: FloatArray, H: FloatArray, y: FloatArray, R: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance after an innovation (2,) of H (2, 10) with the covariance R (2, 2)."""
    gain = _weight(H @ P @ H.T + R, P @ H.T)
    left = np.eye(STATES) - gain @ H
    return x + gain @ y, left @ P @ left.T + gain @ R @ gain.T


def _by_localiser(seen: _Seen, kept: FloatArray) -> tuple[FloatArray, float]:
    """(2, 2) what the tilt errs by that a localiser makes of a fix, and by how much of the mounting's error, 0 to 1: its
    regression on that, in the mean of both axes. `kept` (2, 2): what it has of the tilt that was told."""
    (_, P, H, R), by_picture = seen, UNIT - kept
    of_fix, turned = kept @ H, H[:, MOUNTING]
    of_fix[:, IN_COMMON] -= H[:, IN_COMMON]
    of_mounting = of_fix @ P[:, MOUNTING] @ np.linalg.inv(P[MOUNTING, MOUNTING])
    by_mounting = float(np.vdot(turned, of_mounting) / np.vdot(turned, turned))
    return of_fix @ P @ of_fix.T + by_picture @ R @ by_picture.T, min(1.0, max(0.0, by_mounting))


def _unexpected(nis: float, S: FloatArray) -> FloatArray:
    """By how much (2, 2) the covariance S of an innovation is too small for one that is further off than is ordinary."""
    return np.asarray((max(1.0, nis / ORDINARY_NIS) - 1) * S)


def _changed(before: tuple[Quat, FloatArray], now: tuple[Quat, FloatArray]) -> FloatArray:
    """(2, 10) what the change of the tilt between two frames (each: attitude of the camera's body, what is seen of mounting and
    attitude) is of the states, less the attitude's error before."""
    H = np.zeros((2, STATES))
    H[:, TILT] = now[1]
    H[:, MOUNTING] -= before[1][:, MOUNTING]
    H[:, CAMERA] = by_camera(before[0], now[0])
    return H


def _seen_of(R_ned_frd: FloatArray) -> FloatArray:
    """(2, 4) rotation about north and east by mounting and attitude."""
    seen = np.eye(2, 4, k=2)
    seen[:, :2] = R_ned_frd[:2, :2]
    return seen
