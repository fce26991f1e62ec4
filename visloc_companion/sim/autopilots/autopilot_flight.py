"""The simulated flight itself: true motion, wind, receiver, estimator and control stepped together, without any MAVLink."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from random import Random
from typing import Literal

from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.geo.wgs84 import autopilot_ned_from_geo, geo_from_autopilot_ned, geo_from_ned
from visloc_companion.sim.autopilots.control import Control, Estimated, MissionPath
from visloc_companion.sim.autopilots.control_copter import CopterControl
from visloc_companion.sim.autopilots.control_plane import PlaneControl
from visloc_companion.sim.estimators.estimator import InertialFilter
from visloc_companion.sim.estimators.estimator_ardupilot import ArduPilotEstimator
from visloc_companion.sim.estimators.estimator_attitude import AttitudeEstimate
from visloc_companion.sim.estimators.estimator_output import output_taus
from visloc_companion.sim.estimators.estimator_px4 import Px4Estimator
from visloc_companion.sim.estimators.estimator_status import EstimatorHealth, GnssMeasurement
from visloc_companion.sim.faults import FaultSchedule
from visloc_companion.sim.gnss import GnssReceiver, GnssSample
from visloc_companion.sim.vehicle import Body, Truth
from visloc_companion.sim.vehicles.vehicle_copter import Copter
from visloc_companion.sim.vehicles.vehicle_model import USUAL, VehicleModel
from visloc_companion.sim.vehicles.vehicle_noise import Wind
from visloc_companion.sim.vehicles.vehicle_plane import Plane
from visloc_companion.types import AutopilotKind, GeoPoint, Vec3

PHYSICS_DT_S = 0.01
GNSS_LAG_MS = 200.0
"""ArduPilot's fusion horizon is at least the receiver's lag."""
Phase = Literal["mission", "by_hand", "takeoff", "land", "landed"]


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """What is flown: home (the ground, down = 0), waypoints NED about home in true metres, speed, wind, faults and seed.

    `speed_mps` is over ground for a copter and through the air for a plane. `model`: vehicle, air and sensors.
    """

    kind: AutopilotKind
    vehicle: Literal["copter", "plane"]
    home: GeoPoint
    mission_ned_m: tuple[Vec3, ...]
    speed_mps: float
    seed: int
    faults: FaultSchedule = field(default_factory=FaultSchedule)
    wind_ned_mps: Vec3 = (0.0, 0.0, 0.0)
    start_airborne: bool = True
    model: VehicleModel = USUAL

    def __post_init__(self) -> None:
        if self.kind is AutopilotKind.UNKNOWN:
            raise ValueError("the simulated autopilot is ardupilot or px4")
        if not self.mission_ned_m or not self.speed_mps > 0:
            raise ValueError("a flight needs at least one waypoint and a positive speed")
        if self.vehicle == "plane" and not self.start_airborne:
            raise ValueError("the simulated plane starts in the air: start_airborne must be true")


class Flight:
    """One flight. `step` advances everything by `PHYSICS_DT_S`."""

    def __init__(self, plan: FlightPlan, parameters: Mapping[str, float], origin: GeoPoint | None = None) -> None:
        self.plan, self.t_s, self._steps = plan, 0.0, 0
        self.phase: Phase = "by_hand"
        self.origin: GeoPoint | None = None
        self.gnss: GnssSample | None = None
        self.gnss_place: GeoPoint | None = None
        """The place that the receiver reports (its last one without a fix), None before the first fix."""
        self.pulled_m = 0.0
        self.zero_amsl_m = plan.home.h_amsl_m
        """How high above the sea the autopilot takes the zero of its barometer, home's ground, to lie."""
        self._had_fix, self._position_ok = False, False
        self._rng = {name: Random(f"{plan.seed}/{name}") for name in ("wind", "imu", "gnss", "attitude")}
        plane, ardupilot = plan.vehicle == "plane", plan.kind is AutopilotKind.ARDUPILOT
        self._wind = Wind(self._rng["wind"], plan.wind_ned_mps, plan.speed_mps, plan.model.gust_share)
        self.wind_ned_mps = plan.wind_ned_mps
        self.body = _start_body(plan)
        self._control: Control = (
            PlaneControl(Plane(self.body, plan.speed_mps, plan.model.bank_rad), plan.speed_mps)
            if plane
            else CopterControl(Copter(self.body, plan.model.drag, plan.model.lean_rad), plan.speed_mps)
        )
        horizon_ms = max(parameters["VISO_DELAY_MS"], GNSS_LAG_MS) if ardupilot else parameters["EKF2_DELAY_MAX"]
        self.filter = InertialFilter(
            self._rng["imu"], min(horizon_ms, 1000.0) / 1000, PHYSICS_DT_S, plan.model.imu, output_taus(parameters)
        )
        self.attitude = AttitudeEstimate(self._rng["attitude"], plan.model.attitude)
        estimator = ArduPilotEstimator if ardupilot else Px4Estimator
        self.estimator: ArduPilotEstimator | Px4Estimator = estimator(self.filter, parameters, plane)
        self._receiver = GnssReceiver(self._rng["gnss"])
        self._gnss_due_s = 0.0
        if origin is not None:
            self.set_origin(origin)
        self._start()

    def _start(self) -> None:
        """Align: with GNSS, right or false, the flight begins on its mission, without it by hand until there is a position."""
        b = self.body
        sample = self._sample_gnss()
        local = self.local_from_home((b.north, b.east, b.down))
        if self._had_fix:
            false, false_v = sample.false_ned_m, sample.false_v_ned_mps
            believed = self.local_from_home((b.north + false[0], b.east + false[1], b.down))
            v = (b.v_north + false_v[0], b.v_east + false_v[1], b.v_down)
            self.filter.align((believed[0], believed[1], local[2]), v, false[:2], false_v[:2])
            self.estimator.start_aided()
        else:
            self.filter.align((0.0, 0.0, local[2]), (0.0, 0.0, 0.0))

    def set_origin(self, origin: GeoPoint) -> None:
        """Fix the EKF origin; the mission's waypoints become local to it.

        ArduPilot takes the height of its first one, right or wrong, for that of its barometer's zero (AP_NavEKF3_Control.cpp,
        setOrigin), PX4 keeps to the barometer's own height above the sea (ekf_helper.cpp, initialiseAltitudeTo, setAltOrigin).
        Measured in both makers' simulators: at 488 m with 100 m told they send 100 m and 488 m.
        """
        first = self.origin is None
        self.origin = GeoPoint(round(origin.lat_deg, 7), round(origin.lon_deg, 7), round(origin.h_amsl_m, 3))
        if first and self.plan.kind is AutopilotKind.ARDUPILOT:
            self.zero_amsl_m = self.origin.h_amsl_m
        self.filter.origin_above_home_m = self.origin.h_amsl_m - self.zero_amsl_m
        self._control.path = MissionPath([self.local_from_home(p) for p in self.plan.mission_ned_m])

    def move_origin(self, origin: GeoPoint) -> None:
        """SET_GPS_GLOBAL_ORIGIN: the place stays, its local coordinates follow (before any origin they are kept)."""
        place, above_m = self.place, self.filter.origin_above_home_m
        self.set_origin(origin)
        self.filter.down.shift(self.filter.origin_above_home_m - above_m)
        if place is not None and self.origin is not None:
            local = autopilot_ned_from_geo(self.plan.kind, place, self.origin)
            self.filter.north.shift(local[0] - self.filter.north.p_now)
            self.filter.east.shift(local[1] - self.filter.east.p_now)

    @property
    def local_position_sent(self) -> bool:
        """Whether LOCAL_POSITION_NED goes out: ArduPilot until it stops aiding, PX4 always, whatever it is worth."""
        return self.plan.kind is AutopilotKind.PX4 or not self.health().flags & 0x80

    def local_from_home(self, p_ned_m: Vec3) -> Vec3:
        """True metres about home to the autopilot's local metres about its origin; heights are those above home's ground."""
        origin = self.origin or self.plan.home
        north, east, _ = autopilot_ned_from_geo(self.plan.kind, geo_from_ned(p_ned_m, self.plan.home), origin)
        return north, east, p_ned_m[2] + self.filter.origin_above_home_m

    def _sample_gnss(self) -> GnssSample:
        b = self.body
        effect = self.plan.faults.gnss(self.t_s)
        sample = self._receiver.sample(self.t_s, (b.north, b.east, b.down), (b.v_north, b.v_east, b.v_down), effect)
        self.gnss = sample
        self._had_fix |= sample.has_fix
        self.gnss_place = geo_from_ned(sample.p_ned_m, self.plan.home) if self._had_fix else None
        if sample.has_fix and self.origin is None:
            home, by_gnss = self.plan.home, self.plan.kind is AutopilotKind.ARDUPILOT
            self.set_origin(replace(home, h_amsl_m=home.h_amsl_m - sample.false_ned_m[2]) if by_gnss else home)
        self.estimator.on_gnss(GnssMeasurement(sample, self.local_from_home(sample.p_ned_m)))
        self._gnss_due_s += self._receiver.period_s
        return sample

    def step(self) -> list[str]:
        """Advance by one step of physics; returns texts for the operator."""
        b, dt = self.body, PHYSICS_DT_S
        self.wind_ned_mps = wind = self._wind.step(dt)
        self._fly(dt)
        self._steps += 1
        self.t_s = round(self._steps * dt, 9)
        self.attitude.step(dt)
        self.attitude.compass_error_rad = self.plan.faults.compass_error_rad(self.t_s)
        self.filter.baro_error_m = self.plan.faults.baro_error_m(self.t_s)
        self.filter.step((b.a_north, b.a_east, b.a_down), self.attitude.yaw_error_rad, b.down, dt, b.yaw)
        self.attitude.tilt_ne_rad = self.filter.tilt_ne_rad
        if self.t_s >= self._gnss_due_s - 1e-9:
            self._sample_gnss()
        air = None
        if self.plan.vehicle == "plane":
            error = self.attitude.yaw_error_rad
            air = (b.v_north - wind[0] - error * (b.v_east - wind[1]), b.v_east - wind[1] + error * (b.v_north - wind[0]))
        self.filter.at_rest = b.landed
        texts = self.estimator.step(air)
        self._position_ok = self.health().position_ok
        if self._position_ok:
            self.pulled_m = max(self.pulled_m, math.hypot(*self.filter.pull_ned_m))
        return texts

    def _fly(self, dt_s: float) -> None:
        self._next_phase()
        phase, wind, height = self.phase, self.wind_ned_mps, self.plan.mission_ned_m[0][2]
        if phase == "by_hand" and not self.body.landed:
            self._control.fly("hold", self._by_eye(), height, wind, dt_s)
        elif phase == "takeoff":
            self._control.fly("hold", self._estimated(), height + self.filter.origin_above_home_m, wind, dt_s)
        elif phase in ("mission", "land"):
            self._control.fly("mission" if phase == "mission" else "land", self._estimated(), height, wind, dt_s)

    def _next_phase(self) -> None:
        if self.phase == "by_hand" and self.origin is not None and self.health().position_ok:
            self.phase = "takeoff" if self.body.landed else "mission"
        elif self.phase == "takeoff" and self.body.down < self.plan.mission_ned_m[0][2] + 2.0:
            self.phase = "mission"
        elif self.phase == "land" and self.body.landed:
            self.phase = "landed"

    def health(self) -> EstimatorHealth:
        """The estimator's present health."""
        return self.estimator.health()

    def _estimated(self) -> Estimated:
        n, e, d = self.filter.north, self.filter.east, self.filter.down
        yaw = self.body.yaw + self.attitude.yaw_error_rad
        return Estimated(n.p_now, e.p_now, d.p_now, n.v_now, e.v_now, d.v_now, yaw, self._position_ok)

    def _by_eye(self) -> Estimated:
        """What a pilot who sees the vehicle knows: it is used only before there has been any position."""
        b = self.body
        return Estimated(b.north, b.east, b.down, b.v_north, b.v_east, b.v_down, b.yaw, True)

    @property
    def place(self) -> GeoPoint | None:
        """The estimated place, None without an origin."""
        if self.origin is None:
            return None
        p = (self.filter.north.p_now, self.filter.east.p_now, self.filter.down.p_now)
        return geo_from_autopilot_ned(self.plan.kind, p, self.origin)

    def truth(self, t_boot_ns: int) -> Truth:
        """The true state."""
        b = self.body
        p = (b.north, b.east, b.down)
        return Truth(
            t_boot_ns,
            geo_from_ned(p, self.plan.home),
            p,
            (b.v_north, b.v_east, b.v_down),
            quat_from_euler(b.roll, b.pitch, b.yaw),
            (b.rate_x, b.rate_y, b.rate_z),
            self.wind_ned_mps,
            b.landed,
        )


def _start_body(plan: FlightPlan) -> Body:
    """In the air: at the first waypoint, heading for the second, a plane at its airspeed. Else: at rest at home."""
    if not plan.start_airborne:
        return Body(landed=True)
    first, second = plan.mission_ned_m[0], plan.mission_ned_m[1 % len(plan.mission_ned_m)]
    yaw = math.atan2(second[1] - first[1], second[0] - first[0])
    body = Body(north=first[0], east=first[1], down=first[2], yaw=yaw)
    if plan.vehicle == "plane":
        body.v_north = plan.speed_mps * math.cos(yaw) + plan.wind_ned_mps[0]
        body.v_east = plan.speed_mps * math.sin(yaw) + plan.wind_ned_mps[1]
    return body
