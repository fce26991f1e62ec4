"""MAVSDK's JSON and packets say the same."""

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.encode import int32_of_float, param_set_int32
from visloc_companion.adapters.mavlink.mavsdk_translate import Spoken, Translator

NAN = math.nan
MESSAGES = [
    mav.MAVLink_heartbeat_message(2, 3, 128, 5, 4, 3),
    mav.MAVLink_timesync_message(9007199254740993, -1234567890123456789),
    mav.MAVLink_attitude_message(5, 0.1, -0.2, 3.1, 1e-20, 1e30, 0.0),
    mav.MAVLink_vision_position_estimate_message(2**60 + 1, 1.1, 2.2, -3.3, 0, 0, 0.5, [0.1] * 20 + [NAN], 255),
    mav.MAVLink_statustext_message(4, b"visloc: AIDING", 7, 1),
    mav.MAVLink_named_value_float_message(5, b"VL_PL", 12.5),
    mav.MAVLink_command_long_message(1, 1, 511, 0, 30, 20000, 0, 0, NAN, 0, 0),
]


def packed(message):
    return bytes(message.pack(mav.MAVLink(None, 1, 197)))


def with_id(spoken):
    """MAVSDK adds id and name to the fields it gives."""
    number = next(n for n, kind in mav.mavlink_map.items() if kind.msgname == spoken.name)
    fields = json.loads(spoken.fields_json) | {"message_id": number, "message_name": spoken.name}
    return Spoken(spoken.name, spoken.system_id, spoken.component_id, json.dumps(fields))


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message.get_type())
def test_there_and_back(message):
    translator, packet = Translator(), packed(message)
    spoken = translator.spoken(packet)
    assert (spoken.name, spoken.system_id, spoken.component_id) == (message.get_type(), 1, 197)
    assert translator.packet(with_id(spoken)) == packet


@given(value=st.integers(-(2**31), 2**31 - 1).filter(lambda i: (i & 0x7F800000) != 0x7F800000))
def test_the_bytes_of_an_integer_parameter_survive(value):
    """PX4 wants the integer's bytes in the place of the float."""
    spoken = Translator().spoken(packed(param_set_int32(1, "EKF2_GPS_CTRL", value)))
    fields = json.loads(spoken.fields_json)
    assert int32_of_float(fields["param_value"]) == value
    assert fields["param_id"] == "EKF2_GPS_CTRL"


@pytest.mark.parametrize(
    "fields",
    ["", "null", "[]", "{}", '{"message_id":30}', '{"message_id":16000000}', '{"message_id":30,"time_boot_ms":-1}',
     '{"message_id":"30"}', '{"message_id":111,"tc1":"x","ts1":0}', '{"message_id":111,"tc1":1e300,"ts1":0}'],
)  # fmt: skip
def test_what_does_not_fit_is_passed_over(fields):
    assert Translator().packet(Spoken("ATTITUDE", 1, 1, fields)) is None


@given(text=st.text(max_size=40), system=st.integers(-5, 300))
def test_nothing_raises(text, system):
    Translator().packet(Spoken(text, system, 1, text))
    fields = {"message_id": 253, "severity": 4, "text": text, "id": 0, "chunk_seq": 0}
    Translator().packet(Spoken("STATUSTEXT", system, 1, json.dumps(fields)))


def test_null_is_nan():
    spoken = with_id(Translator().spoken(packed(MESSAGES[3])))
    pose = mav.MAVLink(None).decode(bytearray(Translator().packet(spoken)))
    assert math.isnan(pose.covariance[20])
    assert not any(map(math.isnan, pose.covariance[:20]))
