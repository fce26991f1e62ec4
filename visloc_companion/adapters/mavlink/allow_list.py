"""The whole of what the daemon may ever say to a vehicle; `outbox.Outbox` lets nothing else through.

No arming, no mode, no mission, no parameter but one, whatever the rest of the program asks for.
"""

from __future__ import annotations

from visloc_companion.adapters.mavlink.dialect import AUTOPILOT_COMPONENT, Message, mav

POSITIONS = frozenset(
    (
        mav.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE,
        mav.MAVLINK_MSG_ID_ODOMETRY,
        mav.MAVLINK_MSG_ID_GLOBAL_POSITION_SENSOR,
        mav.MAVLINK_MSG_ID_GPS_INPUT,
    )
)
REPORTS = frozenset(
    (
        mav.MAVLINK_MSG_ID_HEARTBEAT,
        mav.MAVLINK_MSG_ID_TIMESYNC,
        mav.MAVLINK_MSG_ID_STATUSTEXT,
        mav.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT,
        mav.MAVLINK_MSG_ID_NAMED_VALUE_INT,
        mav.MAVLINK_MSG_ID_ONBOARD_COMPUTER_STATUS,
    )
)
ANSWERS = frozenset((mav.MAVLINK_MSG_ID_COMMAND_ACK,))
SAID = POSITIONS | REPORTS | ANSWERS
ORDERS = frozenset(
    (
        mav.MAVLINK_MSG_ID_COMMAND_LONG,
        mav.MAVLINK_MSG_ID_COMMAND_INT,
        mav.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
        mav.MAVLINK_MSG_ID_PARAM_SET,
        mav.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN,
    )
)
"""What changes something in a vehicle: to the one autopilot that is listened to, and to nobody else."""
COMMANDS_LONG = frozenset((mav.MAV_CMD_SET_MESSAGE_INTERVAL, mav.MAV_CMD_REQUEST_MESSAGE, mav.MAV_CMD_SET_EKF_SOURCE_SET))
COMMANDS_INT = frozenset((mav.MAV_CMD_EXTERNAL_POSITION_ESTIMATE,))
PARAMETERS = frozenset(("EKF2_GPS_CTRL",))


def objection(message: Message, system_id: int) -> str | None:
    """Why a message must not be sent to the vehicle `system_id`; None where it may."""
    number, name = message.get_msgId(), message.get_type()
    if number not in ORDERS:
        return None if number in SAID else f"{name} is not on the list of messages"
    if message.target_system != system_id or getattr(message, "target_component", AUTOPILOT_COMPONENT) != AUTOPILOT_COMPONENT:
        return f"{name} is for system {message.target_system}, and only the autopilot of system {system_id} is spoken to"
    commands = {"COMMAND_LONG": COMMANDS_LONG, "COMMAND_INT": COMMANDS_INT}.get(name)
    if commands is not None:
        return None if message.command in commands else f"{name} {message.command} is not on the list of commands"
    if name == "PARAM_SET" and (parameter := _text(message.param_id)) not in PARAMETERS:
        return f"PARAM_SET of {parameter} is not on the list of parameters"
    return None


def _text(name: bytes | str) -> str:
    text = name.decode("ascii", errors="replace") if isinstance(name, bytes) else name
    return text.rstrip("\x00")
