"""A gimbal under the simulated vehicle: how it holds the camera, and what it says of that.

It holds a pitch against the horizon and turns with the vehicle's heading, late; its joints reach only so far. What it says is
late as well, and its sense of the horizon errs slowly.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from random import Random

from visloc_companion.errors import ConfigError
from visloc_companion.geo.se3 import body_rates, quat_from_euler, quat_multiply
from visloc_companion.sim.vehicle import Body, clamp, wrap
from visloc_companion.sim.vehicles.vehicle_noise import GaussMarkov
from visloc_companion.types import Quat, Vec3


@dataclass(frozen=True, slots=True)
class GimbalPlan:
    """`pitches_rad`: from these times on (s, in order, the first no later than 0) it points so far above the horizon, and turns
    there at `slew_radps`. Its pitch joint reaches from `joint_rad[0]` to `joint_rad[1]` against the airframe; it follows the
    heading within `follow_s`.

    1-sigma and correlation times of what is left of the vehicle's motion (`shake`), of the error of the tilt that it states
    (`tilt`) and of that of its yaw against the vehicle (`yaw`); what it states was so `late_s` ago. Raises ConfigError for
    what no gimbal does.
    """

    pitches_rad: tuple[tuple[float, float], ...] = ((0.0, -math.pi / 2),)
    slew_radps: float = math.radians(60.0)
    joint_rad: tuple[float, float] = (math.radians(-125.0), math.radians(45.0))
    follow_s: float = 0.5
    shake_rad: float = math.radians(0.15)
    shake_s: float = 0.5
    tilt_rad: float = math.radians(0.5)
    tilt_s: float = 30.0
    yaw_rad: float = math.radians(1.0)
    yaw_s: float = 60.0
    late_s: float = 0.04

    def __post_init__(self) -> None:
        times_s = [since_s for since_s, _ in self.pitches_rad]
        if not times_s or times_s[0] > 0.0 or times_s != sorted(times_s):
            what = f"pitches_rad are from {times_s} s on"
            raise ConfigError(what, where="GimbalPlan", remedy="begin at 0 s, and go on in order")
        taus = (self.slew_radps, self.follow_s, self.shake_s, self.tilt_s, self.yaw_s)
        if not (min(taus) > 0.0 and self.late_s >= 0.0 and self.joint_rad[0] < self.joint_rad[1]):
            remedy = "give times and slew_radps above 0, and joint_rad from low to high"
            raise ConfigError("turns at no rate, or its joint reaches nowhere", where="GimbalPlan", remedy=remedy)


class SimulatedGimbal:
    """`step` with the vehicle; then `q_ned_body` and `rate_radps` are the truth, `said` what it says."""

    def __init__(self, plan: GimbalPlan, rng: Random, body: Body) -> None:
        self._plan = plan
        self._shake = tuple(GaussMarkov(rng, plan.shake_rad, plan.shake_s) for _ in range(2))
        self._tilt = tuple(GaussMarkov(rng, plan.tilt_rad, plan.tilt_s) for _ in range(2))
        self._yaw_error = GaussMarkov(rng, plan.yaw_rad, plan.yaw_s)
        self._pitch, self._yaw = plan.pitches_rad[0][1], body.yaw
        self._past: deque[tuple[float, Quat]] = deque()
        self.rate_radps: Vec3 = (0.0, 0.0, 0.0)
        self.q_ned_body = self._true(body, body.yaw)

    def step(self, body: Body, t_s: float, dt_s: float) -> None:
        """Advance to `t_s`, with the vehicle as it is then."""
        plan = self._plan
        wanted = [pitch for since_s, pitch in plan.pitches_rad if since_s <= t_s][-1]
        self._pitch += clamp(wanted - self._pitch, plan.slew_radps * dt_s)
        self._yaw += wrap(body.yaw - self._yaw) * min(1.0, dt_s / plan.follow_s)
        for noise in (*self._shake, *self._tilt, self._yaw_error):
            noise.step(dt_s)
        before, self.q_ned_body = self.q_ned_body, self._true(body, self._yaw)
        self.rate_radps = body_rates(before, self.q_ned_body, dt_s)
        self._past.append((t_s, self._stated(body)))
        while len(self._past) > 1 and self._past[1][0] <= t_s - plan.late_s:
            self._past.popleft()

    @property
    def said(self) -> Quat:
        """What it says: attitude of its axes against horizon and heading."""
        return self._past[0][1] if self._past else quat_from_euler(0.0, self._pitch, 0.0)

    def _true(self, body: Body, yaw: float) -> Quat:
        roll, pitch = (noise.value for noise in self._shake)
        return quat_multiply(quat_from_euler(roll, pitch, yaw), quat_from_euler(0.0, self._held(body) + math.pi / 2, 0.0))

    def _held(self, body: Body) -> float:
        """Pitch against the horizon, as far as the joint reaches."""
        least, most = self._plan.joint_rad
        return min(max(self._pitch - body.pitch, least), most) + body.pitch

    def _stated(self, body: Body) -> Quat:
        roll, pitch = (shake.value + tilt.value for shake, tilt in zip(self._shake, self._tilt, strict=True))
        leaning = quat_from_euler(roll, pitch, wrap(self._yaw - body.yaw) + self._yaw_error.value)
        return quat_multiply(leaning, quat_from_euler(0.0, self._held(body), 0.0))
