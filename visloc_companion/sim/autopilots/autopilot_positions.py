"""What the simulated autopilot does with each message that carries a position (autopilot facts, sections 0 to 2).

Velocities in ODOMETRY are not fused, as with the parameters that users are told (EK3_SRC2_VELXY 0, EKF2_EV_CTRL 1); of PX4's
auxiliary positions slot 0 alone is there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from visloc_companion.geo.wgs84 import autopilot_ned_from_geo, ned_from_geo
from visloc_companion.sim.autopilots.autopilot_clock import JitterCorrection, Px4Timesync
from visloc_companion.sim.autopilots.autopilot_flight import Flight
from visloc_companion.sim.autopilots.streams_messages import Message
from visloc_companion.sim.estimators.estimator_ardupilot import ArduPilotEstimator
from visloc_companion.sim.estimators.estimator_px4 import Px4Estimator
from visloc_companion.sim.estimators.estimator_status import AuxiliaryPosition, ExternalPosition, GnssMeasurement
from visloc_companion.sim.gnss import GnssSample
from visloc_companion.types import AutopilotKind, GeoPoint, Vec3

MAX_AGE_S = 10.0
MAVLINK_RECEIVER, MAVLINK_VISION = 14, 1
PX4_FRAMES = (mavlink.MAV_FRAME_LOCAL_NED,)
"""PX4 turns LOCAL_FRD by its own heading's error; here it is not taken at all."""
PX4_ESTIMATORS = range(mavlink.MAV_ESTIMATOR_TYPE_VIO + 1)


class Positions:
    """Takes positions on behalf of the receiver; one jitter filter for all that comes over the link."""

    def __init__(self, flight: Flight, parameters: Mapping[str, float], timesync: Px4Timesync) -> None:
        self._flight, self._parameters, self._timesync = flight, parameters, timesync
        self._kind = flight.plan.kind
        self._jitter = JitterCorrection()
        self._early_s = flight.plan.model.stamped_early_s

    def take(self, message: Message, t_boot_ns: int) -> int | None:
        """Take one message; a MAV_RESULT where it is a command, None otherwise."""
        now_s = t_boot_ns / 1e9
        match message.get_type():
            case "VISION_POSITION_ESTIMATE" | "GLOBAL_VISION_POSITION_ESTIMATE":
                self._pose(message, message.covariance, 0, self._stamp_s(message.usec / 1e6, now_s), now_s)
            case "ODOMETRY" if self._takes(message):
                stamp_s = self._stamp_s(message.time_usec / 1e6, now_s)
                self._pose(message, message.pose_covariance, message.quality, stamp_s, now_s)
            case "GLOBAL_POSITION_SENSOR":
                self._auxiliary(message)
            case "GPS_INPUT":
                self._receiver(message)
            case "COMMAND_INT":
                return self._estimate(message, now_s)
        return None

    def _stamp_s(self, remote_s: float, now_s: float) -> float:
        ardupilot = self._kind is AutopilotKind.ARDUPILOT
        return self._jitter.correct(remote_s, now_s - self._early_s) if ardupilot else self._timesync.convert(remote_s, now_s)

    def _takes(self, message: Message) -> bool:
        """ODOMETRY of another frame is passed over without a word."""
        if self._kind is AutopilotKind.ARDUPILOT:
            frames = mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_FRAME_BODY_FRD
            return (message.frame_id, message.child_frame_id) == frames
        return message.frame_id in PX4_FRAMES and message.estimator_type in PX4_ESTIMATORS

    def _pose(self, message: Message, covariance: list[float], quality: int, stamp_s: float, now_s: float) -> None:
        if self._kind is AutopilotKind.ARDUPILOT:
            blocked = self._parameters["VISO_TYPE"] != MAVLINK_VISION or quality < self._parameters["VISO_QUAL_MIN"]
        else:
            blocked = quality < self._parameters["EKF2_EV_QMIN"]
        if blocked:
            return
        flight = self._flight
        flight.estimator.on_external(
            ExternalPosition(
                flight.filter.t_s - min(now_s - stamp_s, MAX_AGE_S),
                flight.filter.t_s,
                (message.x, message.y, message.z),
                (covariance[0], covariance[6], covariance[11]),
                message.reset_counter,
            )
        )

    def _local(self, lat_e7: int, lon_e7: int, h_amsl_m: float) -> Vec3 | None:
        origin, place = self._flight.origin, GeoPoint(lat_e7 * 1e-7, lon_e7 * 1e-7, h_amsl_m)
        return None if origin is None else autopilot_ned_from_geo(self._kind, place, origin)

    def _auxiliary(self, message: Message) -> None:
        """PX4 takes the time of arrival for that of validity, and no step as announced."""
        estimator, local = self._flight.estimator, self._local(message.lat, message.lon, message.alt)
        if isinstance(estimator, Px4Estimator) and local is not None and message.id == self._parameters["EKF2_AGP0_ID"] != 0:
            estimator.on_auxiliary(AuxiliaryPosition(self._flight.filter.t_s, local, message.eph))

    def _receiver(self, message: Message) -> None:
        """A second receiver, which ArduPilot uses while the first has no fix; without a velocity it stands still."""
        flight, first = self._flight, self._flight.gnss
        ours = self._kind is AutopilotKind.ARDUPILOT and self._parameters["GPS2_TYPE"] == MAVLINK_RECEIVER
        local = self._local(message.lat, message.lon, message.alt)
        if not ours or message.gps_id != 1 or local is None or (first is not None and first.has_fix):
            return
        ignored = message.ignore_flags & mavlink.GPS_INPUT_IGNORE_FLAG_VEL_HORIZ
        velocity = (0.0, 0.0, 0.0) if ignored else (message.vn, message.ve, message.vd)
        home = ned_from_geo(GeoPoint(message.lat * 1e-7, message.lon * 1e-7, message.alt), flight.plan.home)
        h_acc_m = message.horiz_accuracy
        sample = GnssSample(flight.filter.t_s, message.fix_type, message.satellites_visible, home, velocity, h_acc_m)
        flight.estimator.on_gnss(GnssMeasurement(sample, local))

    def _estimate(self, message: Message, now_s: float) -> int:
        """MAV_CMD_EXTERNAL_POSITION_ESTIMATE as ArduPilot takes it (GCS_Common.cpp:5443)."""
        estimator = self._flight.estimator
        if message.command != mavlink.MAV_CMD_EXTERNAL_POSITION_ESTIMATE or not isinstance(estimator, ArduPilotEstimator):
            return int(mavlink.MAV_RESULT_UNSUPPORTED)
        frames = (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT)
        if message.frame not in frames or not math.isnan(message.z):
            return int(mavlink.MAV_RESULT_DENIED)
        stamp_s = self._stamp_s(message.param1, now_s) - message.param2
        local = self._local(message.x, message.y, self._flight.plan.home.h_amsl_m)
        age_s = min(max(now_s - stamp_s, 0.0), 5.0)
        taken = local is not None and estimator.on_estimate(self._flight.filter.t_s - age_s, local, message.param3)
        return int(mavlink.MAV_RESULT_ACCEPTED if taken else mavlink.MAV_RESULT_FAILED)
