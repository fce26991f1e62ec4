"""A multicopter as a point mass whose thrust leans with its attitude, with drag against the air."""

from __future__ import annotations

import math
from dataclasses import dataclass

from visloc_companion.sim.vehicle import GRAVITY_MPS2, Body, clamp
from visloc_companion.sim.vehicles.vehicle_model import LEAN_RAD, Drag
from visloc_companion.types import Vec3


@dataclass(frozen=True, slots=True)
class CopterCommand:
    """What the control asks for: accelerations by thrust in the heading frame (m/s²), down acceleration and yaw rate."""

    forward_mps2: float
    right_mps2: float
    down_mps2: float
    yaw_rate_radps: float


class Copter:
    """Attitude answers as a second-order system (6 rad/s, damping 0.8), thrust within 0.1 s."""

    BANDWIDTH_RADPS, DAMPING, THRUST_TAU_S = 6.0, 0.8, 0.1
    MAX_CLIMB_MPS = 6.0

    def __init__(self, body: Body, drag: Drag | None = None, lean_rad: float = LEAN_RAD) -> None:
        self.body, self.drag, self.lean_rad = body, drag or Drag(), lean_rad
        self._d_roll = self._d_pitch = self._yaw_rate = self._thrust_down = 0.0

    def step(self, command: CopterCommand, wind_ned_mps: Vec3, dt_s: float) -> None:
        """Advance the true state by one step."""
        body = self.body
        if body.landed:
            if command.down_mps2 > -0.3:
                return
            body.landed = False
        w2, damp = self.BANDWIDTH_RADPS**2, 2 * self.DAMPING * self.BANDWIDTH_RADPS
        want_pitch = clamp(-math.atan2(command.forward_mps2, GRAVITY_MPS2), self.lean_rad)
        want_roll = clamp(math.atan2(command.right_mps2, GRAVITY_MPS2), self.lean_rad)
        self._d_roll += (w2 * (want_roll - body.roll) - damp * self._d_roll) * dt_s
        self._d_pitch += (w2 * (want_pitch - body.pitch) - damp * self._d_pitch) * dt_s
        self._yaw_rate += (command.yaw_rate_radps - self._yaw_rate) * min(1.0, dt_s / 0.2)
        body.turn(body.roll + self._d_roll * dt_s, body.pitch + self._d_pitch * dt_s, body.yaw + self._yaw_rate * dt_s, dt_s)
        self._thrust_down += (command.down_mps2 - self._thrust_down) * min(1.0, dt_s / self.THRUST_TAU_S)
        room = (math.copysign(self.MAX_CLIMB_MPS, self._thrust_down) - body.v_down) / dt_s
        if abs(room) < abs(self._thrust_down):
            self._thrust_down = room
        up = GRAVITY_MPS2 - self._thrust_down
        c, s = math.cos(body.yaw), math.sin(body.yaw)
        air_n, air_e = body.v_north - wind_ned_mps[0], body.v_east - wind_ned_mps[1]
        forward = -up * math.tan(body.pitch) - self._dragged(air_n * c + air_e * s)
        right = up * math.tan(body.roll) / math.cos(body.pitch) - self._dragged(air_e * c - air_n * s)
        down = self._thrust_down - self.drag.per_s * (body.v_down - wind_ned_mps[2])
        body.move(forward * c - right * s, forward * s + right * c, down, dt_s)
        if body.down >= 0.0 and body.v_down >= 0.0:
            body.rest()

    def _dragged(self, v_mps: float) -> float:
        """Deceleration by a velocity through the air along one axis, m/s²."""
        return (self.drag.per_s + self.drag.per_m * abs(v_mps)) * v_mps
