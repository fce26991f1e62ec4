"""The simulated vehicle's true motion: what both kinds share, and the truth that is given out."""

from __future__ import annotations

import math
from dataclasses import dataclass

from visloc_companion.types import GeoPoint, Quat, Vec3

GRAVITY_MPS2 = 9.80665


@dataclass(frozen=True, slots=True)
class Truth:
    """Where the vehicle truly is. `p_ned_m` is about home in true metres (geo.wgs84.ned_from_geo); `v_ned_mps` over ground."""

    t_boot_ns: int
    place: GeoPoint
    p_ned_m: Vec3
    v_ned_mps: Vec3
    q_ned_frd: Quat
    rate_frd_radps: Vec3
    wind_ned_mps: Vec3
    landed: bool


@dataclass(slots=True)
class Body:
    """Mutable true state in plain floats: NED metres about home, m/s, m/s², Euler angles (ZYX) in radians and body rates."""

    north: float = 0.0
    east: float = 0.0
    down: float = 0.0
    v_north: float = 0.0
    v_east: float = 0.0
    v_down: float = 0.0
    a_north: float = 0.0
    a_east: float = 0.0
    a_down: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    rate_x: float = 0.0
    rate_y: float = 0.0
    rate_z: float = 0.0
    landed: bool = False

    def move(self, a_north: float, a_east: float, a_down: float, dt_s: float) -> None:
        """Integrate an acceleration that is constant over the step."""
        self.a_north, self.a_east, self.a_down = a_north, a_east, a_down
        self.north += self.v_north * dt_s + 0.5 * a_north * dt_s * dt_s
        self.east += self.v_east * dt_s + 0.5 * a_east * dt_s * dt_s
        self.down += self.v_down * dt_s + 0.5 * a_down * dt_s * dt_s
        self.v_north += a_north * dt_s
        self.v_east += a_east * dt_s
        self.v_down += a_down * dt_s

    def turn(self, roll: float, pitch: float, yaw: float, dt_s: float) -> None:
        """Take a new attitude; the body rates follow from the change (Euler rates to body rates)."""
        d_roll, d_pitch = (roll - self.roll) / dt_s, (pitch - self.pitch) / dt_s
        d_yaw = wrap(yaw - self.yaw) / dt_s
        sr, cr, sp, cp = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
        self.rate_x = d_roll - d_yaw * sp
        self.rate_y = d_pitch * cr + d_yaw * sr * cp
        self.rate_z = -d_pitch * sr + d_yaw * cr * cp
        self.roll, self.pitch, self.yaw = roll, pitch, yaw % (2 * math.pi)

    def rest(self) -> None:
        """Stand on the ground."""
        self.landed, self.down = True, 0.0
        self.v_north = self.v_east = self.v_down = self.a_north = self.a_east = self.a_down = 0.0
        self.roll = self.pitch = self.rate_x = self.rate_y = self.rate_z = 0.0


def clamp(value: float, limit: float) -> float:
    """The value, held within plus or minus the limit."""
    return limit if value > limit else -limit if value < -limit else value


def wrap(angle_rad: float) -> float:
    """The same angle in [-pi, pi)."""
    return (angle_rad + math.pi) % (2 * math.pi) - math.pi
