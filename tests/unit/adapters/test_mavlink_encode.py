"""Texts, commands and parameters on the wire."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.encode import (
    command_long,
    float_of_int32,
    int32_of_float,
    param_set_int32,
    statustext,
)
from visloc_companion.types import Notice, Severity


@given(value=st.integers(0, 2**31 - 1).filter(lambda v: v < 0x7F800000))
def test_integer_parameters_travel_as_bytes(value):
    message = param_set_int32(1, "EKF2_GPS_CTRL", value)
    packer = mav.MAVLink(None, 1, 197)
    again = packer.decode(bytearray(message.pack(packer)))
    assert int32_of_float(again.param_value) == value
    assert (again.param_id, again.param_type) == ("EKF2_GPS_CTRL", 6)


def test_seven_is_not_sent_as_seven():
    assert float_of_int32(7) == pytest.approx(9.8e-45, rel=0.01)


def test_texts_and_commands():
    text = statustext(Notice(Severity.WARNING, "GNSS über 30 m off" + "!" * 50))
    assert (text.severity, len(text.text)) == (mav.MAV_SEVERITY_WARNING, 50)
    command = command_long(4, 511, 30.0, 20000.0)
    assert (command.target_system, command.target_component, command.command) == (4, 1, 511)
    assert (command.param1, command.param2, command.param3, command.param7) == (30.0, 20000.0, 0.0, 0.0)
