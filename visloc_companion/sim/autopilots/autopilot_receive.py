"""What the simulated autopilot does with each message of the companion."""

from __future__ import annotations

import math
from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.sim.autopilots.autopilot_clock import Px4Timesync
from visloc_companion.sim.autopilots.autopilot_flight import Flight
from visloc_companion.sim.autopilots.autopilot_parameters import decode, encode
from visloc_companion.sim.autopilots.autopilot_positions import Positions
from visloc_companion.sim.autopilots.streams import Streams
from visloc_companion.sim.autopilots.streams_messages import Message
from visloc_companion.sim.estimators.estimator_ardupilot import ArduPilotEstimator
from visloc_companion.types import AutopilotKind, GeoPoint

POSITIONS = ("VISION_POSITION_ESTIMATE", "ODOMETRY", "GLOBAL_POSITION_SENSOR", "GPS_INPUT", "COMMAND_INT")


class Receiver:
    """Takes messages; returns answers, and collects in `requested` the ids of messages that are to be sent at once."""

    def __init__(self, flight: Flight, parameters: dict[str, float], system_id: int, ready_s: float) -> None:
        self.requested: list[int] = []
        self.streams = Streams(flight.plan.kind, flight.plan.vehicle)
        self._flight, self._parameters, self._system_id, self._ready_s = flight, parameters, system_id, ready_s
        self._kind = flight.plan.kind
        self._timesync = Px4Timesync()
        self._positions = Positions(flight, parameters, self._timesync)
        self._handlers: dict[str, Callable[[Message, int], list[Message]]] = {
            **dict.fromkeys(POSITIONS, self._position),
            "TIMESYNC": self._on_timesync,
            "COMMAND_LONG": self._command,
            "PARAM_REQUEST_LIST": self._parameter_list,
            "PARAM_REQUEST_READ": self._parameter_read,
            "MISSION_REQUEST_LIST": self._mission_list,
            "MISSION_REQUEST_INT": self._mission_item,
            "PARAM_SET": self._parameter_set,
            "SET_GPS_GLOBAL_ORIGIN": self._set_origin,
        }
        if self._kind is AutopilotKind.ARDUPILOT:
            self._handlers["GLOBAL_VISION_POSITION_ESTIMATE"] = self._position

    def take(self, message: Message, t_boot_ns: int) -> list[Message]:
        """Handle one message; those for another system and unknown ones are ignored."""
        handler = self._handlers.get(message.get_type())
        if handler is None or getattr(message, "target_system", 0) not in (0, self._system_id):
            return []
        return handler(message, t_boot_ns)

    def _position(self, message: Message, t_boot_ns: int) -> list[Message]:
        result = self._positions.take(message, t_boot_ns)
        if result is None:
            return []
        asker = message.get_srcSystem(), message.get_srcComponent()
        return [mavlink.MAVLink_command_ack_message(message.command, result, 0, 0, *asker)]

    def _on_timesync(self, message: Message, t_boot_ns: int) -> list[Message]:
        if message.tc1 == 0:
            return [mavlink.MAVLink_timesync_message(t_boot_ns, message.ts1)]
        if self._kind is AutopilotKind.PX4:
            self._timesync.reply(message.ts1 / 1e9, message.tc1 / 1e9, t_boot_ns / 1e9)
        return []

    def _command(self, message: Message, t_boot_ns: int) -> list[Message]:
        number = int(message.command)
        if not math.isfinite(message.param1):
            result = mavlink.MAV_RESULT_DENIED
        elif number == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            result = self._set_interval(int(message.param1), message.param2)
        elif number == mavlink.MAV_CMD_REQUEST_MESSAGE:
            result = self._request(int(message.param1))
        elif number == mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
            result = self._request(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        elif number == mavlink.MAV_CMD_SET_EKF_SOURCE_SET:
            result = self._use_set(message.param1)
        else:
            result = mavlink.MAV_RESULT_UNSUPPORTED
        del t_boot_ns
        return [mavlink.MAVLink_command_ack_message(number, result, 0, 0, message.get_srcSystem(), message.get_srcComponent())]

    def _set_interval(self, message_id: int, interval_us: float) -> int:
        """ArduPilot accepts intervals before it is ready and then forgets them."""
        if not math.isfinite(interval_us):
            return int(mavlink.MAV_RESULT_DENIED)
        if self._kind is AutopilotKind.ARDUPILOT and self._flight.t_s < self._ready_s:
            return int(mavlink.MAV_RESULT_ACCEPTED)
        return self.streams.set_interval(message_id, interval_us, self._flight.t_s)

    def _request(self, message_id: int) -> int:
        if message_id not in self.streams.available:
            return int(mavlink.MAV_RESULT_FAILED)
        self.requested.append(message_id)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _use_set(self, number: float) -> int:
        estimator = self._flight.estimator
        if not isinstance(estimator, ArduPilotEstimator):
            return int(mavlink.MAV_RESULT_UNSUPPORTED)
        if number not in (1, 2, 3):
            return int(mavlink.MAV_RESULT_DENIED)
        estimator.use_set(int(number))
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _mission_list(self, message: Message, t_boot_ns: int) -> list[Message]:
        del t_boot_ns
        asker = message.get_srcSystem(), message.get_srcComponent()
        return [mavlink.MAVLink_mission_count_message(*asker, len(self._flight.plan.mission_ned_m))]

    def _mission_item(self, message: Message, t_boot_ns: int) -> list[Message]:
        del t_boot_ns
        plan = self._flight.plan
        if message.seq >= len(plan.mission_ned_m):
            return []
        place = geo_from_ned(plan.mission_ned_m[message.seq], plan.home)
        asker = message.get_srcSystem(), message.get_srcComponent()
        where = round(place.lat_deg * 1e7), round(place.lon_deg * 1e7), place.h_amsl_m - plan.home.h_amsl_m
        frame, command = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, mavlink.MAV_CMD_NAV_WAYPOINT
        return [mavlink.MAVLink_mission_item_int_message(*asker, message.seq, frame, command, 0, 1, 0, 0, 0, 0, *where)]

    def _parameter_list(self, message: Message, t_boot_ns: int) -> list[Message]:
        del message, t_boot_ns
        return [self._parameter_value(name) for name in self._parameters]

    def _parameter_read(self, message: Message, t_boot_ns: int) -> list[Message]:
        del t_boot_ns
        if message.param_index >= 0:
            names = list(self._parameters)
            return [self._parameter_value(names[message.param_index])] if message.param_index < len(names) else []
        name = _name(message)
        return [self._parameter_value(name)] if name in self._parameters else []

    def _parameter_set(self, message: Message, t_boot_ns: int) -> list[Message]:
        del t_boot_ns
        name = _name(message)
        if name not in self._parameters:
            return []
        value = decode(self._kind, name, message.param_value)
        if math.isfinite(value):
            self._parameters[name] = value
        return [self._parameter_value(name)]

    def _parameter_value(self, name: str) -> Message:
        value, kind = encode(self._kind, name, self._parameters[name])
        names = list(self._parameters)
        return mavlink.MAVLink_param_value_message(name.encode(), value, kind, len(names), names.index(name))

    def _set_origin(self, message: Message, t_boot_ns: int) -> list[Message]:
        """ArduPilot takes an origin once and ignores further ones in silence; PX4 moves it at any time."""
        del t_boot_ns
        if self._kind is AutopilotKind.ARDUPILOT and self._flight.origin is not None:
            return []
        place = GeoPoint(message.latitude / 1e7, message.longitude / 1e7, message.altitude / 1000)
        if abs(place.lat_deg) <= 90 and abs(place.lon_deg) <= 180:
            self._flight.move_origin(place)
        return []


def _name(message: Message) -> str:
    name = message.param_id
    return str(name if isinstance(name, str) else name.decode("ascii", "replace")).rstrip("\0")
