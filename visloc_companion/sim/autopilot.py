"""The built-in autopilot: a simulated vehicle that speaks MAVLink 2 as ArduPilot or PX4 does. Sans I/O.

pilot = BuiltInAutopilot(AutopilotKind.ARDUPILOT, "copter", home, mission, 10.0, seed=1, faults=jam(120))
pilot.receive(bytes_from_companion); pilot.step(0.01); bytes_to_companion = pilot.outgoing()
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from random import Random
from typing import Any, Literal

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from visloc_companion.sim.autopilots.autopilot_flight import PHYSICS_DT_S, Flight, FlightPlan
from visloc_companion.sim.autopilots.autopilot_modes import Failsafe, custom_mode
from visloc_companion.sim.autopilots.autopilot_parameters import prepared_parameters
from visloc_companion.sim.autopilots.autopilot_receive import Receiver
from visloc_companion.sim.autopilots.streams_messages import BUILDERS, Message, Ranged, Snapshot, heartbeat
from visloc_companion.sim.faults import FaultSchedule
from visloc_companion.sim.vehicle import Truth
from visloc_companion.sim.vehicles.accelerometer import Accelerometer
from visloc_companion.sim.vehicles.gimbal import GimbalPlan, SimulatedGimbal
from visloc_companion.sim.vehicles.pitot import Pitot
from visloc_companion.sim.vehicles.rangefinder import Rangefinder
from visloc_companion.sim.vehicles.vehicle_model import USUAL, VehicleModel
from visloc_companion.types import AutopilotKind, GeoPoint, Quat, Vec3

HEARTBEAT_S, TIMESYNC_S = 1.0, 0.1


class BuiltInAutopilot:
    """One vehicle with its autopilot.

    `mission_ned_m` are waypoints NED about `home` in true metres (home is on the ground, down = 0), flown in a loop; one
    waypoint alone is held. `faults` count from the start of the simulation, when the autopilot has run for `boot_age_s`
    (by default it boots then).
    `start_airborne` begins at the first waypoint; else a copter takes off as soon as it has a position. Without GNSS at the
    start the vehicle is flown by hand (it keeps its place by eye; a plane circles) until its estimator has a position and
    an origin; `origin` is one that the ground station set before, else the first fix or SET_GPS_GLOBAL_ORIGIN gives it.
    With a `rangefinder` it sends DISTANCE_SENSOR to who asks for it, with a `gimbal`, which then carries the camera,
    GIMBAL_DEVICE_ATTITUDE_STATUS.
    ArduPilot is "ready" `ready_s` after the start: it accepts stream requests before that and forgets them.
    `parameters` change the prepared vehicle's (autopilot_parameters.PREPARED). Raises ValueError for a plan that cannot be
    flown. Deterministic by `seed` and by what is received.
    """

    def __init__(
        self,
        kind: AutopilotKind,
        vehicle: Literal["copter", "plane"],
        home: GeoPoint,
        mission_ned_m: Sequence[Vec3],
        speed_mps: float,
        seed: int,
        faults: FaultSchedule | None = None,
        wind_ned_mps: Vec3 = (0.0, 0.0, 0.0),
        start_airborne: bool = True,
        parameters: Mapping[str, float] | None = None,
        system_id: int = 1,
        boot_age_s: float = 0.0,
        origin: GeoPoint | None = None,
        ready_s: float = 0.0,
        rangefinder: Rangefinder | None = None,
        model: VehicleModel = USUAL,
        gimbal: GimbalPlan | None = None,
    ) -> None:
        way, wrong = tuple(mission_ned_m), faults or FaultSchedule()
        plan = FlightPlan(kind, vehicle, home, way, speed_mps, seed, wrong, wind_ned_mps, start_airborne, model)
        self.parameters = prepared_parameters(kind, parameters or {})
        self.flight = Flight(plan, self.parameters, origin)
        self._boot_ns = round(boot_age_s * 1e9)
        self._steps, self._owed_s = 0, 0.0
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=mavlink.MAV_COMP_ID_AUTOPILOT1)
        self._mav.robust_parsing = True
        self._out = bytearray()
        self._receiver = Receiver(self.flight, self.parameters, system_id, ready_s)
        self._failsafe = Failsafe(kind, vehicle)
        self._heartbeat_due_s = self._timesync_due_s = 0.0
        self._ready_due_s = ready_s if kind is AutopilotKind.ARDUPILOT and ready_s > 0 else math.inf
        self._origin_sent: GeoPoint | None = None
        self._rangefinder, self._range_rng = rangefinder, Random(f"{seed}/range")
        self._accelerometer = Accelerometer(Random(f"{seed}/force"), model.accelerometers)
        self._pitot = Pitot(Random(f"{seed}/pitot"), model.tube)
        self._gimbal = None if gimbal is None else SimulatedGimbal(gimbal, Random(f"{seed}/gimbal"), self.flight.body)

    # ------------------------------------------------------------------------------------------------------------- drive

    def receive(self, data: bytes) -> None:
        """Take bytes of the companion; garbage is skipped. Answers are in `outgoing()`."""
        for message in (self._mav.parse_buffer(data) or []) if data else []:
            for answer in self._receiver.take(message, self.t_boot_ns):
                self._send(answer)
        self._send_requested()

    def step(self, dt_s: float) -> None:
        """Advance the simulation, in whole steps of physics (what is left over counts for the next call)."""
        self._owed_s += dt_s
        while self._owed_s >= PHYSICS_DT_S - 1e-9:
            self._owed_s -= PHYSICS_DT_S
            self._steps += 1
            self._step()

    def outgoing(self) -> bytes:
        """Bytes for the companion since the last call."""
        data, self._out = bytes(self._out), bytearray()
        return data

    def _step(self) -> None:
        texts = self.flight.step()
        if self._gimbal is not None:
            self._gimbal.step(self.flight.body, self.t_s, PHYSICS_DT_S)
        texts += self._failsafe.step(self.flight, self.parameters)
        for text in texts:
            self._send(mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_CRITICAL, text.encode()))
        now_s = self.t_s
        if now_s >= self._ready_due_s:
            self._ready_due_s = math.inf
            self._send(mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_INFO, b"ArduPilot Ready"))
        if now_s >= self._heartbeat_due_s:
            self._heartbeat_due_s += HEARTBEAT_S
            self._send(heartbeat(self._snapshot()))
        if self.kind is AutopilotKind.PX4 and now_s >= self._timesync_due_s:
            self._timesync_due_s += TIMESYNC_S
            self._send(mavlink.MAVLink_timesync_message(0, self.t_boot_ns))
        if self.flight.origin != self._origin_sent:
            self._origin_sent = self.flight.origin
            self._receiver.requested.append(mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
        self._receiver.requested += self._receiver.streams.due(now_s)
        self._send_requested()

    def _send_requested(self) -> None:
        if not self._receiver.requested:
            return
        wanted, self._receiver.requested = self._receiver.requested, []
        snapshot = self._snapshot(wanted)
        for message_id in wanted:
            message = BUILDERS[message_id](snapshot)
            if message is not None:
                self._send(message)

    def _asked_for(self, wanted: Sequence[int]) -> dict[str, Any]:
        """The fields of a snapshot that take work, or of which a sensor keeps count, where one of these messages tells them."""
        flight, fields = self.flight, dict[str, Any]()
        if mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT in wanted:
            told = self.kind is AutopilotKind.ARDUPILOT or flight.health().position_ok
            fields["place"] = flight.place if told else None
        if mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR in wanted:
            fields["range"] = self._ranged()
        if mavlink.MAVLINK_MSG_ID_SCALED_IMU in wanted:
            fields["force_frd_mps2"] = self._accelerometer.measured(flight.body, self.t_s)
        if mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE in wanted and flight.plan.vehicle == "plane":
            fields["airspeed_mps"] = self._pitot.measured_mps(flight.body, flight.wind_ned_mps)
        if self._gimbal is not None and not self.faults.gimbal_silent(self.t_s):
            fields["q_heading_gimbal"] = self._gimbal.said
        return fields

    def _send(self, message: Message) -> None:
        self._out += message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256

    # ------------------------------------------------------------------------------------------------------------- state

    @property
    def kind(self) -> AutopilotKind:
        """Which autopilot this is."""
        return self.flight.plan.kind

    @property
    def t_s(self) -> float:
        """Time since the start of the simulation, the time base of the faults."""
        return self.flight.t_s

    @property
    def t_boot_ns(self) -> int:
        """The autopilot's own clock, ns since its boot; a fault may make it step."""
        return self.t_sim_ns + self.faults.autopilot_clock_ns(self.t_s)

    @property
    def t_sim_ns(self) -> int:
        """The simulation's time: what the autopilot's clock would show without any step."""
        return self._boot_ns + self._steps * round(PHYSICS_DT_S * 1e9)

    def truth(self) -> Truth:
        """Where the vehicle truly is."""
        return self.flight.truth(self.t_boot_ns)

    def camera_carrier(self) -> tuple[Quat, Vec3]:
        """True attitude of what carries the camera, and its rates about its own axes: the airframe, or a body that is level while
        the gimbal points straight down."""
        if self._gimbal is None:
            truth = self.truth()
            return truth.q_ned_frd, truth.rate_frd_radps
        return self._gimbal.q_ned_body, self._gimbal.rate_radps

    def estimate(self) -> GeoPoint | None:
        """Where the autopilot believes to be (stale while `position_ok` is False), None before it has an origin."""
        return self.flight.place

    def gnss_reported(self) -> GeoPoint | None:
        """Where the receiver says the vehicle is; None without a fix."""
        return self.flight.gnss_place if self.flight.gnss is not None and self.flight.gnss.has_fix else None

    @property
    def position_ok(self) -> bool:
        """Whether the estimator vouches for its horizontal position."""
        return self.flight.health().position_ok

    @property
    def failsafe(self) -> str | None:
        """The text of the failsafe that ended the mission, None while there was none."""
        return self._failsafe.text

    @property
    def failsafe_t_s(self) -> float | None:
        """When it fired, seconds since the start."""
        return self._failsafe.t_s

    @property
    def pulled_m(self) -> float:
        """Largest distance so far by which false GNSS moved the vehicle.

        The estimator is linear between resets, so the part of its position that false GNSS alone produced is carried beside
        the estimate with the same gains; the vehicle, which flies on the estimate, is moved by just that part, reversed.
        It counts only while the autopilot has a position to fly on.
        """
        return self.flight.pulled_m

    @property
    def source(self) -> str:
        """The horizontal position in use: `gnss`, `external` or `none`."""
        return self.flight.health().source

    @property
    def mode(self) -> str:
        """What the vehicle does: mission, by_hand, takeoff, land or landed."""
        return self.flight.phase

    @property
    def faults(self) -> FaultSchedule:
        """The schedule of faults (the camera's side asks it too)."""
        return self.flight.plan.faults

    def _ranged(self) -> Ranged | None:
        sensor, truth = self._rangefinder, self.truth()
        if sensor is None:
            return None
        return Ranged(sensor.measured_m(truth.place, truth.q_ned_frd, self._range_rng), sensor.min_m, sensor.max_m)

    def _snapshot(self, wanted: Sequence[int] = ()) -> Snapshot:
        """The state, with all that these messages tell of it."""
        flight, plan = self.flight, self.flight.plan
        f, health = flight.filter, flight.health()
        return Snapshot(
            kind=plan.kind,
            t_boot_ns=self.t_boot_ns,
            rpy_rad=flight.attitude.euler(flight.body),
            rates_radps=flight.attitude.rates(flight.body),
            p_ned_m=(f.north.p_now, f.east.p_now, f.down.p_now),
            v_ned_mps=(f.north.v_now, f.east.v_now, f.down.v_now),
            home=GeoPoint(plan.home.lat_deg, plan.home.lon_deg, flight.zero_amsl_m),
            origin=flight.origin,
            local=flight.local_position_sent,
            gnss=flight.gnss,
            gnss_place=flight.gnss_place or GeoPoint(0.0, 0.0, 0.0),
            dated=flight.gnss_place is not None,
            health=health,
            baro_amsl_m=plan.home.h_amsl_m - f.baro_down_m,
            external_healthy=flight.estimator.external_healthy,
            mav_type=mavlink.MAV_TYPE_FIXED_WING if plan.vehicle == "plane" else mavlink.MAV_TYPE_QUADROTOR,
            custom_mode=custom_mode(plan.kind, plan.vehicle, flight.phase),
            armed=flight.phase != "landed" and not (flight.phase == "by_hand" and flight.body.landed),
            failsafe=self._failsafe.text is not None,
            **self._asked_for(wanted),
        )
