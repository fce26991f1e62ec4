"""Texts, commands and parameters as MAVLink 2 messages (positions: outputs/)."""

from __future__ import annotations

import struct

from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.types import AutopilotKind, Notice, Severity

STATUSTEXT_LENGTH = 50
_SEVERITIES = {
    Severity.INFO: mav.MAV_SEVERITY_INFO,
    Severity.NOTICE: mav.MAV_SEVERITY_NOTICE,
    Severity.WARNING: mav.MAV_SEVERITY_WARNING,
    Severity.CRITICAL: mav.MAV_SEVERITY_CRITICAL,
}


def statustext(notice: Notice) -> Message:
    """STATUSTEXT (253), cut to its 50 characters; characters beyond ASCII become '?'."""
    text = notice.text.encode("ascii", errors="replace")[:STATUSTEXT_LENGTH]
    return mav.MAVLink_statustext_message(_SEVERITIES[notice.severity], text)


def heartbeat(state: int) -> Message:
    """HEARTBEAT (0) of a companion computer with a MAV_STATE."""
    return mav.MAVLink_heartbeat_message(mav.MAV_TYPE_ONBOARD_CONTROLLER, mav.MAV_AUTOPILOT_INVALID, 0, 0, state, 3)


def station_heartbeat() -> Message:
    """HEARTBEAT (0) of a ground station."""
    return mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, mav.MAV_STATE_ACTIVE, 3)


def command_long(system_id: int, command: int, *params: float, confirmation: int = 0) -> Message:
    """COMMAND_LONG (76) to the autopilot component; unnamed parameters are 0."""
    filled = (*params, *(0.0 for _ in range(7 - len(params))))
    return mav.MAVLink_command_long_message(system_id, 1, command, confirmation, *filled)


def param_set_int32(system_id: int, name: str, value: int) -> Message:
    """PARAM_SET (23) of a 32-bit integer as PX4 wants it: its bytes in the place of the float's, not its value."""
    return mav.MAVLink_param_set_message(system_id, 1, name.encode("ascii"), float_of_int32(value), mav.MAV_PARAM_TYPE_INT32)


def parameter_value(msg: Message, kind: AutopilotKind) -> float:
    """The value of a PARAM_VALUE (22): PX4 puts an integer's bytes in the place of the float's, ArduPilot its value."""
    real = msg.param_type in (mav.MAV_PARAM_TYPE_REAL32, mav.MAV_PARAM_TYPE_REAL64)
    return float(int32_of_float(msg.param_value)) if kind is AutopilotKind.PX4 and not real else float(msg.param_value)


def float_of_int32(value: int) -> float:
    """The float whose bytes are those of the integer (exact for all that is not a NaN's pattern)."""
    return float(struct.unpack("<f", struct.pack("<i", value))[0])


def int32_of_float(value: float) -> int:
    """The integer whose bytes are those of the float."""
    return int(struct.unpack("<i", struct.pack("<f", value))[0])
