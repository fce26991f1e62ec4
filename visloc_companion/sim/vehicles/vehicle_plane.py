"""A fixed-wing aircraft as a point mass in coordinated flight: it banks to turn and drifts with the air."""

from __future__ import annotations

import math
from dataclasses import dataclass

from visloc_companion.sim.vehicle import GRAVITY_MPS2, Body, clamp
from visloc_companion.sim.vehicles.vehicle_model import BANK_RAD
from visloc_companion.types import Vec3


@dataclass(frozen=True, slots=True)
class PlaneCommand:
    """What the control asks for: bank angle (rad, right positive), climb rate (m/s) and airspeed (m/s)."""

    bank_rad: float
    climb_mps: float
    airspeed_mps: float


class Plane:
    """Bank answers in 0.4 s (60°/s and `bank_rad` at most), climb in 0.8 s, airspeed in 3 s; the nose is 3° above the path.

    A gust carries the aircraft along with a lag of 0.5 s: what its lift and drag need to change its velocity.
    """

    ANGLE_OF_ATTACK_RAD = math.radians(3)
    MAX_ROLL_RATE_RADPS = math.radians(60)
    MAX_CLIMB_MPS = 4.0
    GUST_LAG_S = 0.5

    def __init__(self, body: Body, airspeed_mps: float, bank_rad: float = BANK_RAD) -> None:
        self.body = body
        self.airspeed_mps, self.bank_rad = airspeed_mps, bank_rad
        self._climb = 0.0
        self._carried_by: Vec3 | None = None

    def step(self, command: PlaneCommand, wind_ned_mps: Vec3, dt_s: float) -> None:
        """Advance the true state by one step."""
        body = self.body
        if body.landed:
            return
        bank = clamp(command.bank_rad, self.bank_rad)
        roll = body.roll + clamp((bank - body.roll) / 0.4, self.MAX_ROLL_RATE_RADPS) * dt_s
        self._climb += (clamp(command.climb_mps, self.MAX_CLIMB_MPS) - self._climb) * dt_s / 0.8
        self.airspeed_mps += (command.airspeed_mps - self.airspeed_mps) * dt_s / 3.0
        path = math.asin(clamp(self._climb / self.airspeed_mps, 0.5))
        yaw = body.yaw + GRAVITY_MPS2 * math.tan(roll) / self.airspeed_mps * dt_s
        body.turn(roll, path + self.ANGLE_OF_ATTACK_RAD, yaw, dt_s)
        level = self.airspeed_mps * math.cos(path)
        north, east, down = self._carried(wind_ned_mps, dt_s)
        body.move(
            (level * math.cos(yaw) + north - body.v_north) / dt_s,
            (level * math.sin(yaw) + east - body.v_east) / dt_s,
            (-self._climb + down - body.v_down) / dt_s,
            dt_s,
        )
        if body.down >= 0.0 and body.v_down >= 0.0:
            body.rest()

    def _carried(self, wind_ned_mps: Vec3, dt_s: float) -> Vec3:
        """The part of the wind that the aircraft's velocity has taken up by now."""
        n, e, d = wind_ned_mps if self._carried_by is None else self._carried_by
        share = dt_s / self.GUST_LAG_S
        self._carried_by = (
            n + share * (wind_ned_mps[0] - n),
            e + share * (wind_ned_mps[1] - e),
            d + share * (wind_ned_mps[2] - d),
        )
        return self._carried_by
