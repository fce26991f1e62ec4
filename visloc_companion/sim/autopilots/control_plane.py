"""Control of the plane: L1 guidance (Park, Deyst, How 2004) along the legs, loiter about a single waypoint, height, landing."""

from __future__ import annotations

import math

from visloc_companion.sim.autopilots.control import Estimated, Manner, MissionPath, PathPoint
from visloc_companion.sim.vehicle import GRAVITY_MPS2, clamp, wrap
from visloc_companion.sim.vehicles.vehicle_plane import Plane, PlaneCommand
from visloc_companion.types import Vec3

L1_S, BLIND_BANK_RAD, SINK_MPS = 2.5, math.radians(15), 2.0
MIN_LOITER_RADIUS_M, LOITER_BANK_RAD = 80.0, math.radians(22)


class PlaneControl:
    """Flies the mission at an airspeed, or circles at a fixed bank where it knows no position."""

    def __init__(self, vehicle: Plane, speed_mps: float) -> None:
        self.path: MissionPath | None = None
        self._vehicle, self._speed = vehicle, speed_mps
        self._loiter_m = max(MIN_LOITER_RADIUS_M, speed_mps**2 / (GRAVITY_MPS2 * math.tan(LOITER_BANK_RAD)))

    def fly(self, manner: Manner, at: Estimated, hold_down_m: float, wind_ned_mps: Vec3, dt_s: float) -> None:
        """Decide from the estimate and advance the vehicle by one step."""
        if manner == "land":
            command = PlaneCommand(BLIND_BANK_RAD, -SINK_MPS, self._speed)
        elif manner == "mission" and self.path is not None:
            command = self._mission(self.path, at)
        else:
            command = PlaneCommand(BLIND_BANK_RAD, clamp(-0.4 * (hold_down_m - at.down), 4.0), self._speed)
        self._vehicle.step(command, wind_ned_mps, dt_s)

    def _mission(self, path: MissionPath, at: Estimated) -> PlaneCommand:
        """Bank for the lateral acceleration 2 V² sin(eta) / L1."""
        ground = max(math.hypot(at.v_north, at.v_east), 3.0)
        reach = L1_S * ground
        point = path.at(at.north, at.east, 0.8 * reach)
        want = _loiter_course(point, self._loiter_m) if point.single else _leg_course(point, reach)
        eta = wrap(want - math.atan2(at.v_east, at.v_north))
        lateral = 2 * ground * ground / reach * math.sin(clamp(eta, math.pi / 2))
        if point.single:
            lateral += ground * ground / self._loiter_m
        bank = clamp(math.atan(lateral / GRAVITY_MPS2), self._vehicle.bank_rad)
        return PlaneCommand(bank, clamp(-0.4 * (point.down_m - at.down), 4.0), self._speed)


def _leg_course(point: PathPoint, reach_m: float) -> float:
    cross = math.hypot(point.cross_north, point.cross_east)
    ahead = math.sqrt(max(reach_m**2 - cross**2, (0.3 * reach_m) ** 2))
    return math.atan2(ahead * point.along_east - point.cross_east, ahead * point.along_north - point.cross_north)


def _loiter_course(point: PathPoint, loiter_m: float) -> float:
    """Clockwise about the waypoint, turned inward or outward by how far off the circle it is."""
    radius = math.hypot(point.cross_north, point.cross_east)
    outward = math.atan2(point.cross_east, point.cross_north)
    return outward + math.pi / 2 + math.atan((radius - loiter_m) / (0.5 * loiter_m))
