"""What the autopilot is sent: the state now, in its own projection, with a finite covariance and an honest reset_counter."""

from __future__ import annotations

import math

from visloc_companion.core.covariance import floored
from visloc_companion.core.protection import Protected
from visloc_companion.core.requests import SIGMA_YAW_RAD
from visloc_companion.core.settings import InjectionSettings
from visloc_companion.core.step import step_m
from visloc_companion.core.validate import MAX_LOCAL_M, MAX_SPEED_MPS, is_covariance
from visloc_companion.geo import wgs84
from visloc_companion.types import (
    AutopilotKind,
    Cov2,
    GeoPoint,
    GnssVerdict,
    Injection,
    InjectionPolicy,
    Mode,
    NavState,
    Quat,
    Status,
    Vec3,
    Verdict,
)

RESET_MODULUS = 256
"""reset_counter is a uint8 (VISION_POSITION_ESTIMATE)."""
LEAST_SIGMA_MPS = 0.1
"""1-sigma on each axis that is claimed of a velocity, at least."""
RECKONED_MPS2 = 0.05
"""Error of its accelerations that an autopilot's own filter reckons with: the gyroscopes' noise that EKF3 and EKF2 are set for
(0.015 rad/s at 100 Hz) tilts them by so much in 10 s."""


def is_due(policy: InjectionPolicy, verdict: Verdict) -> bool:
    """Whether the policy wants injection under this verdict."""
    if policy is InjectionPolicy.WHEN_UNRELIABLE:
        return verdict is not Verdict.OK
    return policy is InjectionPolicy.ALWAYS


class ResetCounter:
    """Counts the discontinuities of the output.

    A discontinuity is a restart of the filter, a moved origin, or a step between two outputs (after motion by the velocity)
    of more than `max_step_m`: each would otherwise be taken for motion, or be rejected for seconds (docs/ardupilot.md).
    """

    def __init__(self, max_step_m: float) -> None:
        self._max_step_m = max_step_m
        self._count = 0
        self._last: NavState | None = None
        self._started_ns: int | None = None

    @property
    def count(self) -> int:
        """The counter as sent, modulo 256."""
        return self._count

    def bump(self) -> None:
        """Count a discontinuity; the next output starts the comparison anew."""
        self._count = (self._count + 1) % RESET_MODULUS
        self._last = None

    def begin_beside(self, count: int) -> None:
        """Positions of another filter were sent until a while ago, with this count, or one that was raised a few times since."""
        self._count = (count + RESET_MODULUS // 2) % RESET_MODULUS

    def follow(self, state: NavState, started_ns: int) -> int:
        """The counter for an output of a filter that was started (or restarted) at a time."""
        restarted = self._started_ns is not None and started_ns != self._started_ns
        if restarted or (self._last is not None and self._has_stepped(self._last, state)):
            self.bump()
        self._last, self._started_ns = state, started_ns
        return self._count

    def _has_stepped(self, last: NavState, state: NavState) -> bool:
        dt_s = (state.t_ns - last.t_ns) * 1e-9
        return step_m(last.p_ned_m, last.v_ned_mps, state.p_ned_m, state.v_ned_mps, dt_s) > self._max_step_m


def injection(
    state: NavState,
    q_ned_frd: Quat,
    origin: GeoPoint,
    autopilot: AutopilotKind,
    settings: InjectionSettings,
    reset_counter: int,
    sigma_d_m: float,
    least_sigma_m: float = 0.0,
    stream_sigma_m: float = 0.0,
) -> Injection | None:
    """The external position for a state, or None where it would not be finite and sane (never NaN, never absurd).

    No principal sigma below `least_sigma_m`, or that of the settings, is claimed; `stream_sigma_m`: see `stream_sigma_m()`.

    The vertical is the autopilot's own height (baro), unchanged: nothing vertical that we estimate is sent back.
    """
    if not all(map(math.isfinite, (*state.p_ned_m, *q_ned_frd, sigma_d_m))):
        return None
    if math.hypot(*state.p_ned_m) > MAX_LOCAL_M or not is_covariance(state.cov_ne_m2):
        return None
    place = wgs84.geo_from_ned(state.p_ned_m, origin)
    known, cov_v = velocity(state)
    return Injection(
        state.t_ns,
        wgs84.autopilot_ned_from_geo(autopilot, place, origin),
        place,
        q_ned_frd,
        floored(state.cov_ne_m2, max(settings.min_sigma_m, least_sigma_m)),
        sigma_d_m,
        SIGMA_YAW_RAD,
        reset_counter,
        known,
        cov_v,
        stream_sigma_m,
    )


def stream_sigma_m(fix_noise_m2s: float, sigma_a_mps2: float, rate_hz: float) -> float:
    """1-sigma that each of `rate_hz` positions a second may claim to a filter that takes each for news, m.

    The slow errors of a filter driven by accelerations are those of its fixes: of so much noise (variance times interval). As
    many positions as are sent have the same noise if each claims that times the rate. How far a filter follows positions depends
    on their noise over that of its accelerations: where those are worse than it reckons (`sigma_a_mps2`), it must follow sooner,
    and less is claimed (docs/decisions/0023-positions-claim-what-their-fixes-are-worth.md).
    """
    share = min(1.0, (RECKONED_MPS2 / sigma_a_mps2) ** 2) if sigma_a_mps2 > 0 else 1.0
    return math.sqrt(share * fix_noise_m2s * rate_hz)


def velocity(state: NavState) -> tuple[Vec3 | None, Cov2 | None]:
    """The state's velocity in NED (m/s) and the covariance of its horizontal part, neither where it is not known or sane."""
    cov = state.cov_v_ne_m2ps2
    if cov is None or not all(map(math.isfinite, state.v_ned_mps)) or max(map(abs, state.v_ned_mps)) > MAX_SPEED_MPS:
        return None, None
    return (state.v_ned_mps, floored(cov, LEAST_SIGMA_MPS)) if is_covariance(cov) else (None, None)


def status(
    state: NavState,
    last_fix_ns: int | None,
    protected: Protected,
    origin: GeoPoint,
    mode: Mode,
    verdict: GnssVerdict,
    reset_counter: int,
    injected: bool,
    open_places: int = 0,
    place: GeoPoint | None = None,
) -> Status:
    """The Status of a Tick; `place`: the state's, where it is known already."""
    return Status(
        state.t_ns,
        mode,
        verdict.verdict,
        verdict.reasons,
        wgs84.geo_from_ned(state.p_ned_m, origin) if place is None else place,
        state.v_ned_mps,
        state.cov_ne_m2,
        state.sigma_d_m,
        protected.levels.horizontal_m,
        None if last_fix_ns is None else max(0.0, (state.t_ns - last_fix_ns) * 1e-9),
        injected,
        reset_counter,
        protected.levels.vertical_m,
        protected.height_offset_m,
        protected.limits.horizontal_m,
        protected.limits.vertical_m,
        protected.available,
        protected.alert,
        open_places,
    )


def empty_status(t_ns: int, mode: Mode, verdict: GnssVerdict, reset_counter: int) -> Status:
    """The Status while there is no state."""
    nothing: Cov2 = ((0.0, 0.0), (0.0, 0.0))
    still = (0.0, 0.0, 0.0)
    return Status(t_ns, mode, verdict.verdict, verdict.reasons, None, still, nothing, 0.0, None, None, False, reset_counter)
