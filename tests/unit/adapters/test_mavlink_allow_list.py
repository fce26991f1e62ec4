"""What may be said to a vehicle, and that nothing else leaves the outbox."""

import pytest

from visloc_companion.adapters.mavlink.allow_list import ORDERS, SAID, objection
from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.encode import command_long, param_set_int32
from visloc_companion.adapters.mavlink.outbox import Outbox
from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.errors import LinkError

ALL_COMMANDS = sorted({v for k, v in vars(mav).items() if k.startswith("MAV_CMD_") and isinstance(v, int)})
HELD_BACK = {
    "arming": command_long(1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0),
    "mode": mav.MAVLink_set_mode_message(1, 1, 4),
    "mission": mav.MAVLink_mission_count_message(1, 1, 3),
    "key": mav.MAVLink_setup_signing_message(1, 1, bytes(32), 1),
    "parameter": param_set_int32(1, "EKF2_EV_CTRL", 1),
    "similar parameter": param_set_int32(1, "EKF2_GPS_CTRL2", 1),
    "another vehicle": command_long(2, mav.MAV_CMD_SET_EKF_SOURCE_SET, 2.0),
    "every vehicle": command_long(0, mav.MAV_CMD_SET_EKF_SOURCE_SET, 2.0),
    "another component": mav.MAVLink_command_long_message(1, 154, mav.MAV_CMD_REQUEST_MESSAGE, 0, 1, 0, 0, 0, 0, 0, 0),
    "manual control": mav.MAVLink_rc_channels_override_message(1, 1, *[1500] * 8),
    "setpoint": mav.MAVLink_set_position_target_global_int_message(0, 1, 1, 6, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0),
}


@pytest.mark.parametrize("message", HELD_BACK.values(), ids=HELD_BACK)
def test_what_is_held_back(message):
    outbox = Outbox(197)
    with pytest.raises(LinkError, match="must not be sent"):
        outbox.put(message)
    assert (outbox.drain(), outbox.forbidden) == ([], 1)


def test_of_all_messages_these_may_be_sent():
    assert {mav.mavlink_map[number].msgname for number in SAID | ORDERS} == {
        "HEARTBEAT",
        "TIMESYNC",
        "STATUSTEXT",
        "NAMED_VALUE_FLOAT",
        "NAMED_VALUE_INT",
        "ONBOARD_COMPUTER_STATUS",
        "COMMAND_ACK",
        "VISION_POSITION_ESTIMATE",
        "ODOMETRY",
        "GLOBAL_POSITION_SENSOR",
        "GPS_INPUT",
        "COMMAND_LONG",
        "COMMAND_INT",
        "PARAM_REQUEST_READ",
        "PARAM_SET",
        "SET_GPS_GLOBAL_ORIGIN",
    }


def test_of_all_commands_four_may_be_sent():
    long = [number for number in ALL_COMMANDS if objection(command_long(1, number), 1) is None]
    whole = [n for n in ALL_COMMANDS if objection(mav.MAVLink_command_int_message(1, 1, 0, n, 0, 0, *[0] * 7), 1) is None]
    assert (long, whole) == ([511, 512, 42007], [43003])


def test_in_flight_it_is_counted_and_told_once(monkeypatch):
    monkeypatch.setattr(Outbox, "strict", False)
    session = MavlinkSession(SessionSettings())
    for message in HELD_BACK.values():
        session._outbox.put(message)
    assert session.packets() == []
    assert session.forbidden == len(HELD_BACK)
    assert ["must never be sent" in text for text in (*session.warnings(), *session.warnings())] == [True]
