"""A small autopilot that speaks MAVLink bytes, for tests of links: it hovers, streams what it is asked for, notes what it gets.

It does not fly or estimate; `visloc_companion.sim` has one that does. Sans-IO: `receive`, `step`, `outgoing`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.adapters.mavlink.encode import float_of_int32, int32_of_float
from visloc_companion.adapters.mavlink.framing import Framer
from visloc_companion.testing.signing_peer import PymavlinkSigning
from visloc_companion.types import AutopilotKind, GeoPoint

_NS_PER_S = 1_000_000_000
_TOLD = ("NAMED_VALUE_FLOAT", "NAMED_VALUE_INT", "ONBOARD_COMPUTER_STATUS")
_MAX_POS_ERR_M, _MAX_ANG_ERR_RAD = 100.0, 1.5
_OTHER_POSITIONS = ("ODOMETRY", "GLOBAL_POSITION_SENSOR", "GPS_INPUT", "COMMAND_INT")


@dataclass(slots=True)
class Behaviour:
    """What the autopilot does with requests; a test changes it as it goes.

    `deny_above_hz`: faster streams are denied. `deaf_requests`: so many rate requests are acknowledged and then lost.
    `mute_commands`: commands get no ACK. `answers_switch`: MAV_RESULT of a source switch (PX4: nonzero refuses).
    `silent`: nothing is sent at all. `asks_timesync`: it asks for our clock, as PX4 does.
    """

    deny_above_hz: float = math.inf
    deaf_requests: int = 0
    mute_commands: bool = False
    answers_switch: int = 0
    silent: bool = False
    asks_timesync: bool = False


@dataclass(slots=True)
class FakeAutopilot:
    """Kind, identity and place; then what was received.

    `origin` None is an estimator without origin. Everything received stays in the lists, oldest first.
    """

    kind: AutopilotKind = AutopilotKind.ARDUPILOT
    system_id: int = 1
    origin: GeoPoint | None = field(default_factory=lambda: GeoPoint(47.3977, 8.5456, 488.0))
    behaviour: Behaviour = field(default_factory=Behaviour)
    source_set: int = 1
    plane: bool = False
    params: dict[str, int] = field(default_factory=lambda: {"EKF2_GPS_CTRL": 7})
    rates_hz: dict[int, float] = field(default_factory=dict)
    heartbeats: list[Message] = field(default_factory=list)
    poses: list[Message] = field(default_factory=list)
    positions: list[Message] = field(default_factory=list)
    """What carries a position otherwise than VISION_POSITION_ESTIMATE (which is in `poses`)."""
    texts: list[str] = field(default_factory=list)
    told: list[Message] = field(default_factory=list)
    timesync_replies: list[Message] = field(default_factory=list)
    signing: PymavlinkSigning | None = None
    _framer: Framer = field(init=False)
    _out: list[bytes] = field(default_factory=list)
    _seq: int = 0
    _boot_ns: int = 0
    _next_ns: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._framer = Framer(None if self.signing is None else self.signing.admits)

    @property
    def framer(self) -> Framer:
        """Counts what arrived."""
        return self._framer

    def receive(self, data: bytes) -> None:
        """Take bytes and answer at once."""
        for msg in self._framer.feed(data):
            self._take(msg)

    def step(self, t_boot_ns: int) -> None:
        """Move the autopilot's clock and stream what is due."""
        self._boot_ns = t_boot_ns
        rates_hz = {mav.MAVLINK_MSG_ID_HEARTBEAT: 1.0, **self.rates_hz}
        if self.behaviour.asks_timesync:
            rates_hz[mav.MAVLINK_MSG_ID_TIMESYNC] = 10.0
        for message_id, rate_hz in rates_hz.items():
            if t_boot_ns >= self._next_ns.get(message_id, 0):
                due_ns = self._next_ns.get(message_id, t_boot_ns) + round(_NS_PER_S / rate_hz)
                self._next_ns[message_id] = max(due_ns, t_boot_ns)
                self._send_id(message_id)

    def reboot(self) -> None:
        """Forget the streams and start the clock anew."""
        self.rates_hz.clear()
        self._next_ns.clear()
        self._boot_ns = 0

    def outgoing(self) -> bytes:
        """What is to be sent; forgotten by the call."""
        data = b"".join(self._out)
        self._out.clear()
        return b"" if self.behaviour.silent else data

    def heartbeat_type(self) -> int:
        """MAV_TYPE of what flies."""
        return int(mav.MAV_TYPE_FIXED_WING if self.plane else mav.MAV_TYPE_QUADROTOR)

    def believed_sigma_m(self) -> float:
        """The horizontal 1-sigma that this kind of autopilot reads out of the latest pose."""
        c = self.poses[-1].covariance
        if self.kind is AutopilotKind.ARDUPILOT:
            return min(_MAX_POS_ERR_M, float((c[0] ** 2 + c[6] ** 2 + c[11] ** 2) ** (1 / 3)))
        return math.sqrt(max(c[0], c[6]))

    def believed_angle_sigma_rad(self) -> float:
        """The same for the angles."""
        c = self.poses[-1].covariance
        if self.kind is AutopilotKind.ARDUPILOT:
            return min(_MAX_ANG_ERR_RAD, float((c[15] ** 2 + c[18] ** 2 + c[20] ** 2) ** (1 / 3)))
        return math.sqrt(c[20])

    # ------------------------------------------------------------------------------------------------------------ inside

    def send(self, message: Message) -> None:
        """Pack and queue a message of this autopilot."""
        packer = mav.MAVLink(None, srcSystem=self.system_id, srcComponent=1)
        packer.seq, self._seq = self._seq, (self._seq + 1) % 256
        self._out.append(message.pack(packer) if self.signing is None else self.signing.pack(message, packer))

    def _take(self, msg: Message) -> None:
        kind = msg.get_type()
        if kind == "HEARTBEAT":
            self.heartbeats.append(msg)
        elif kind == "VISION_POSITION_ESTIMATE":
            self.poses.append(msg)
        elif kind in _OTHER_POSITIONS:
            self.positions.append(msg)
        elif kind == "STATUSTEXT":
            self.texts.append(msg.text)
        elif kind in _TOLD:
            self.told.append(msg)
        elif kind == "TIMESYNC":
            if msg.tc1 == 0:
                self.send(mav.MAVLink_timesync_message(max(1, self._boot_ns), msg.ts1))
            else:
                self.timesync_replies.append(msg)
        elif kind == "COMMAND_LONG" and msg.target_system == self.system_id and not self.behaviour.mute_commands:
            result = self._command(msg)
            addressee = (msg.get_srcSystem(), msg.get_srcComponent())
            self.send(mav.MAVLink_command_ack_message(msg.command, result, 0, 0, *addressee))
        elif kind == "PARAM_REQUEST_READ" and msg.target_system == self.system_id and msg.param_id in self.params:
            self._send_param(msg.param_id)
        elif kind == "PARAM_SET" and msg.target_system == self.system_id and not self.behaviour.mute_commands:
            self._set_param(msg)

    def _command(self, msg: Message) -> int:
        if msg.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL:
            return self._set_interval(int(msg.param1), msg.param2)
        if msg.command == mav.MAV_CMD_REQUEST_MESSAGE:
            return int(mav.MAV_RESULT_ACCEPTED if self._send_id(int(msg.param1)) else mav.MAV_RESULT_FAILED)
        if msg.command == mav.MAV_CMD_SET_EKF_SOURCE_SET and self.kind is AutopilotKind.ARDUPILOT:
            if self.behaviour.answers_switch == mav.MAV_RESULT_ACCEPTED:
                self.source_set = int(msg.param1)
            return self.behaviour.answers_switch
        return int(mav.MAV_RESULT_UNSUPPORTED)

    def _set_interval(self, message_id: int, interval_us: float) -> int:
        rate_hz = 1e6 / interval_us
        if rate_hz > self.behaviour.deny_above_hz:
            return int(mav.MAV_RESULT_DENIED)
        if message_id not in mav.mavlink_map:
            return int(mav.MAV_RESULT_FAILED)
        if self.behaviour.deaf_requests > 0:
            self.behaviour.deaf_requests -= 1
        else:
            self.rates_hz[message_id] = rate_hz
        return int(mav.MAV_RESULT_ACCEPTED)

    def _set_param(self, msg: Message) -> None:
        if msg.param_id not in self.params:
            return
        if self.behaviour.answers_switch == mav.MAV_RESULT_ACCEPTED and msg.param_type == mav.MAV_PARAM_TYPE_INT32:
            self.params[msg.param_id] = int32_of_float(msg.param_value)
        self._send_param(msg.param_id)

    def _send_param(self, name: str) -> None:
        """PX4 sends an integer's bytes in the place of the float's, ArduPilot its value."""
        value, kind = float(self.params[name]), mav.MAV_PARAM_TYPE_INT8
        if self.kind is AutopilotKind.PX4:
            value, kind = float_of_int32(self.params[name]), mav.MAV_PARAM_TYPE_INT32
        self.send(mav.MAVLink_param_value_message(name.encode(), value, kind, len(self.params), 0))

    def _send_id(self, message_id: int) -> bool:
        message = self._message(message_id)
        if message is not None:
            self.send(message)
        return message is not None

    def _message(self, message_id: int) -> Message | None:
        boot_ms, boot_us = self._boot_ns // 1_000_000, self._boot_ns // 1000
        px4 = self.kind is AutopilotKind.PX4
        place = self.origin or GeoPoint(0.0, 0.0, 0.0)
        message: Message | None
        lat_e7, lon_e7, alt_mm = round(place.lat_deg * 1e7), round(place.lon_deg * 1e7), round(place.h_amsl_m * 1e3)
        match message_id:
            case mav.MAVLINK_MSG_ID_HEARTBEAT:
                autopilot = mav.MAV_AUTOPILOT_PX4 if px4 else mav.MAV_AUTOPILOT_ARDUPILOTMEGA
                message = mav.MAVLink_heartbeat_message(self.heartbeat_type(), autopilot, 0, 0, mav.MAV_STATE_STANDBY, 3)
            case mav.MAVLINK_MSG_ID_TIMESYNC:
                message = mav.MAVLink_timesync_message(0, max(1, self._boot_ns))
            case mav.MAVLINK_MSG_ID_ATTITUDE:
                message = mav.MAVLink_attitude_message(boot_ms, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0)
            case mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
                message = mav.MAVLink_global_position_int_message(boot_ms, lat_e7, lon_e7, alt_mm, 0, 0, 0, 0, 65535)
            case mav.MAVLINK_MSG_ID_GPS_RAW_INT:
                message = mav.MAVLink_gps_raw_int_message(boot_us, 3, lat_e7, lon_e7, alt_mm, 90, 120, 0, 0, 14, 0, 800, 1200)
            case mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
                version = (1 << 24 | 16 << 16 | 255) if px4 else (4 << 24 | 6 << 16 | 3 << 8 | 255)
                nothing = [0] * 8
                message = mav.MAVLink_autopilot_version_message(0, version, 0, 0, 0, nothing, nothing, nothing, 0, 0, 0)
            case mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN if self.origin is not None:
                message = mav.MAVLink_gps_global_origin_message(lat_e7, lon_e7, alt_mm, boot_us)
            case _:
                message = None
        return message
