"""The operator's "I am here" in flight: MAV_CMD_EXTERNAL_POSITION_ESTIMATE (43003) from a ground station to this component.

As a COMMAND_INT (x and y in degrees times 1e7) or a COMMAND_LONG (param5 and param6 in degrees: float32, good to a metre or two);
param3 is the accuracy (1-sigma) in metres, NaN or 0 where it is not known. What the position is worth is the navigator's to say.
"""

from __future__ import annotations

import math

from visloc_companion.adapters.mavlink.dialect import GLOBAL_FRAMES, Message, mav
from visloc_companion.core.validate import MAX_OPERATOR_SIGMA_M, is_place
from visloc_companion.types import GeoPoint, OperatorFix

COMMAND = mav.MAV_CMD_EXTERNAL_POSITION_ESTIMATE
UNKNOWN_SIGMA_M = 50.0


def is_for(msg: Message, system_id: int, component_id: int) -> bool:
    """Whether a message is a command to one component of a system, and to no other."""
    if msg.get_type() not in ("COMMAND_INT", "COMMAND_LONG"):
        return False
    return bool(msg.target_system == system_id and msg.target_component == component_id)


def taken(msg: Message, ready: bool, now_ns: int) -> tuple[Message, OperatorFix | None]:
    """The COMMAND_ACK for a command, and the position in it. `ready`: the navigator can take one (the origin is known).

    ACCEPTED means that the position goes to the navigator, which then tells the operator what it makes of it.
    """
    if msg.command != COMMAND:
        return _ack(msg, mav.MAV_RESULT_UNSUPPORTED), None
    place, sigma_m = _place(msg), _sigma_m(msg.param3)
    if place is None or sigma_m is None:
        return _ack(msg, mav.MAV_RESULT_DENIED), None
    if not ready:
        return _ack(msg, mav.MAV_RESULT_TEMPORARILY_REJECTED), None
    return _ack(msg, mav.MAV_RESULT_ACCEPTED), OperatorFix(now_ns, place, sigma_m)


def command(system_id: int, component_id: int, place: GeoPoint, sigma_m: float) -> Message:
    """The COMMAND_INT by which a ground station says it to the component of a vehicle's companion."""
    e7 = round(place.lat_deg * 1e7), round(place.lon_deg * 1e7)
    frame = mav.MAV_FRAME_GLOBAL
    return mav.MAVLink_command_int_message(
        system_id, component_id, frame, COMMAND, 0, 0, math.nan, 0.0, sigma_m, math.nan, *e7, math.nan
    )


def _place(msg: Message) -> GeoPoint | None:
    if msg.get_type() == "COMMAND_INT":
        place = GeoPoint(msg.x / 1e7, msg.y / 1e7, 0.0) if msg.frame in GLOBAL_FRAMES else None
    else:
        place = GeoPoint(float(msg.param5), float(msg.param6), 0.0)
    return place if place is not None and is_place(place) else None


def _sigma_m(stated_m: float) -> float | None:
    if math.isnan(stated_m) or stated_m == 0:
        return UNKNOWN_SIGMA_M
    return float(stated_m) if 0 < stated_m <= MAX_OPERATOR_SIGMA_M else None


def _ack(msg: Message, result: int) -> Message:
    return mav.MAVLink_command_ack_message(msg.command, result, 0, 0, msg.get_srcSystem(), msg.get_srcComponent())
