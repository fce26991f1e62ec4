"""Control of the multicopter: velocity along the leg, cross-track correction, height, and landing."""

from __future__ import annotations

import math

from visloc_companion.sim.autopilots.control import Estimated, Manner, MissionPath
from visloc_companion.sim.vehicle import GRAVITY_MPS2, clamp, wrap
from visloc_companion.sim.vehicles.vehicle_copter import Copter, CopterCommand
from visloc_companion.types import Vec3

CORNER_MPS, BRAKE_MPS2, ACCEL_MPS2 = 3.0, 1.5, 3.0
VELOCITY_P_PER_S, VELOCITY_I_PER_S2 = 2.0, 1.0
"""ArduCopter's PSC_VELXY_P and _I (PX4's MPC_XY_VEL_P_ACC is 1.8)."""
DESCENT_FAST_MPS, DESCENT_SLOW_MPS, SLOW_BELOW_M = 1.5, 0.5, 10.0


class CopterControl:
    """Flies the mission, lands, or holds still; the velocity asked for changes by ACCEL_MPS2 at most, and the lean that cancels
    wind and drag is kept as an integral."""

    def __init__(self, vehicle: Copter, speed_mps: float) -> None:
        self.path: MissionPath | None = None
        self._vehicle, self._speed = vehicle, speed_mps
        self._trim_n = self._trim_e = 0.0
        self._asked: tuple[float, float] | None = None
        self._most_mps2 = GRAVITY_MPS2 * math.tan(vehicle.lean_rad)

    def fly(self, manner: Manner, at: Estimated, hold_down_m: float, wind_ned_mps: Vec3, dt_s: float) -> None:
        """Decide from the estimate and advance the vehicle by one step."""
        if manner == "land":
            command = self._land(at, dt_s)
        elif manner == "mission" and self.path is not None:
            command = self._mission(self.path, at, dt_s)
        else:
            command = self._toward(at, 0.0, 0.0, clamp(0.7 * (hold_down_m - at.down), 2.5), at.yaw, dt_s)
        self._vehicle.step(command, wind_ned_mps, dt_s)

    def _mission(self, path: MissionPath, at: Estimated, dt_s: float) -> CopterCommand:
        """Follow the mission at the given speed, slower towards corners."""
        point = path.at(at.north, at.east, 2.0)
        speed = min(self._speed, math.sqrt(CORNER_MPS**2 + 2 * BRAKE_MPS2 * point.remaining_m))
        cross = math.hypot(point.cross_north, point.cross_east)
        back = min(0.5, (self._speed if point.single else 0.6 * self._speed) / cross) if cross > 1e-6 else 0.0
        along = 0.0 if point.single else math.sqrt(max(0.0, speed**2 - min(back * cross, speed) ** 2))
        want_n = along * point.along_north - back * point.cross_north
        want_e = along * point.along_east - back * point.cross_east
        yaw = at.yaw if point.single else math.atan2(point.along_east, point.along_north)
        return self._toward(at, want_n, want_e, clamp(0.7 * (point.down_m - at.down), 2.5), yaw, dt_s)

    def _land(self, at: Estimated, dt_s: float) -> CopterCommand:
        """Descend: 1.5 m/s, then 0.5 m/s below 10 m; level and drifting with the wind where there is no position."""
        descent = DESCENT_FAST_MPS if at.down < -SLOW_BELOW_M else DESCENT_SLOW_MPS
        if at.position_ok:
            return self._toward(at, 0.0, 0.0, descent, at.yaw, dt_s)
        return CopterCommand(0.0, 0.0, clamp(2.0 * (descent - at.v_down), 3.0), 0.0)

    def _toward(
        self, at: Estimated, want_n: float, want_e: float, want_down_mps: float, yaw: float, dt_s: float
    ) -> CopterCommand:
        rate_n, rate_e, asked_n, asked_e = self._shaped(at, want_n, want_e, dt_s)
        d_n, d_e = asked_n - at.v_north, asked_e - at.v_east
        a_n = rate_n + VELOCITY_P_PER_S * d_n + self._trim_n
        a_e = rate_e + VELOCITY_P_PER_S * d_e + self._trim_e
        if math.hypot(a_n, a_e) < self._most_mps2 or d_n * self._trim_n + d_e * self._trim_e < 0.0:
            self._trim_n = clamp(self._trim_n + VELOCITY_I_PER_S2 * d_n * dt_s, self._most_mps2)
            self._trim_e = clamp(self._trim_e + VELOCITY_I_PER_S2 * d_e * dt_s, self._most_mps2)
        c, s = math.cos(at.yaw), math.sin(at.yaw)
        return CopterCommand(
            a_n * c + a_e * s,
            a_e * c - a_n * s,
            clamp(2.0 * (want_down_mps - at.v_down), 4.0),
            clamp(1.2 * wrap(yaw - at.yaw), math.radians(60)),
        )

    def _shaped(self, at: Estimated, want_n: float, want_e: float, dt_s: float) -> tuple[float, float, float, float]:
        """The acceleration (north, east) by which the velocity asked for goes to the one wanted, and where it has come to."""
        n, e = self._asked or (at.v_north, at.v_east)
        d_n, d_e = want_n - n, want_e - e
        size = math.hypot(d_n, d_e)
        share = min(1.0, ACCEL_MPS2 * dt_s / size) if size > 1e-9 else 1.0
        self._asked = n + share * d_n, e + share * d_e
        return share * d_n / dt_s, share * d_e / dt_s, *self._asked
