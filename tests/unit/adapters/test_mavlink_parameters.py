"""Reading a handful of parameters."""

import pytest

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.encode import float_of_int32
from visloc_companion.adapters.mavlink.parameters import AGAIN_NS, AT_ONCE, TIMEOUT_NS, TRIES, ParameterReader
from visloc_companion.types import AutopilotKind

NAMES = ("EKF2_EV_CTRL", "EKF2_EV_QMIN", "A", "B", "C", "D")


def value(name: str, field: float, kind: int):
    packer = mav.MAVLink(None, 1, 1)
    return packer.decode(bytearray(mav.MAVLink_param_value_message(name.encode(), field, kind, 1, 0).pack(packer)))


def asked(messages) -> list[str]:
    return [message.param_id for message in messages]


def test_a_few_at_once_until_all_are_answered():
    reader = ParameterReader()
    assert reader.complete
    reader.start(AutopilotKind.ARDUPILOT, NAMES)
    first = asked(reader.poll(1, 0))
    assert first == list(NAMES[:AT_ONCE])
    assert reader.poll(1, 1) == []
    for name in first:
        assert reader.take(value(name, 2.0, mav.MAV_PARAM_TYPE_INT8))
    assert asked(reader.poll(1, 2)) == list(NAMES[AT_ONCE:])
    assert not reader.complete
    for name in NAMES[AT_ONCE:]:
        reader.take(value(name, 3.0, mav.MAV_PARAM_TYPE_INT8))
    assert reader.complete
    assert reader.values["EKF2_EV_CTRL"] == 2.0


def test_what_is_not_answered_is_asked_again_and_then_given_up():
    reader = ParameterReader()
    reader.start(AutopilotKind.PX4, ("A",))
    requests = [reader.poll(1, n * TIMEOUT_NS) for n in range(TRIES + 2)]
    assert [len(some) for some in requests] == [1] * TRIES + [0, 0]
    assert reader.complete
    assert reader.values == {}


def test_what_was_given_up_is_asked_for_now_and_then_all_the_same():
    reader = ParameterReader()
    reader.start(AutopilotKind.ARDUPILOT, NAMES)
    given_up_ns, later = 0, list[str]()
    while not reader.complete:
        given_up_ns += TIMEOUT_NS
        reader.poll(1, given_up_ns)
    assert reader.poll(1, given_up_ns + AGAIN_NS - 1) == []
    for n in (1, 2):
        later += asked(reader.poll(1, given_up_ns + n * AGAIN_NS))
        assert reader.complete, "what is asked for again keeps nobody waiting"
        assert len(later) == n * AT_ONCE
        assert reader.poll(1, given_up_ns + n * AGAIN_NS + TIMEOUT_NS) == []
    assert set(later) == set(NAMES), "each in its turn"
    for name in NAMES[1:]:
        reader.take(value(name, 2.0, mav.MAV_PARAM_TYPE_INT8))
    assert asked(reader.poll(1, given_up_ns + 3 * AGAIN_NS)) == [NAMES[0]]


def test_what_is_read_again_is_known_meanwhile_unless_it_is_another_kinds():
    reader = ParameterReader()
    reader.start(AutopilotKind.PX4, ("X",))
    reader.take(value("X", 1.0, mav.MAV_PARAM_TYPE_REAL32))
    reader.start(AutopilotKind.PX4, ("X",))
    assert (reader.values, reader.complete) == ({"X": 1.0}, False)
    reader.start(AutopilotKind.ARDUPILOT, ("X",))
    assert reader.values == {}


def test_px4_sends_an_integers_bytes_and_ardupilot_its_value():
    for kind, field in ((AutopilotKind.PX4, float_of_int32(13)), (AutopilotKind.ARDUPILOT, 13.0)):
        reader = ParameterReader()
        reader.start(kind, ("X",))
        reader.take(value("X", field, mav.MAV_PARAM_TYPE_INT32))
        assert reader.values == {"X": 13.0}


def test_others_are_passed_over_and_changes_are_noticed():
    reader = ParameterReader()
    reader.start(AutopilotKind.PX4, ("X",))
    assert not reader.take(value("Y", 1.0, mav.MAV_PARAM_TYPE_REAL32))
    assert reader.take(value("X", 1.0, mav.MAV_PARAM_TYPE_REAL32))
    assert not reader.take(value("X", 1.0, mav.MAV_PARAM_TYPE_REAL32))
    assert reader.take(value("X", 2.0, mav.MAV_PARAM_TYPE_REAL32))
    assert reader.values == {"X": pytest.approx(2.0)}
