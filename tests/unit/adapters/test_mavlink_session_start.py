"""The first words with an autopilot that flies: a daemon that is started again has seconds until its failsafe."""

from __future__ import annotations

import pytest

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.framing import Framer
from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.testing.conversation import Conversation
from visloc_companion.testing.fake_autopilot import FakeAutopilot
from visloc_companion.types import AutopilotKind, LinkChanged, OriginChanged

ATTITUDE, ATTITUDE_HZ = mav.MAVLINK_MSG_ID_ATTITUDE, 20.0
REQUEST, INTERVAL = mav.MAV_CMD_REQUEST_MESSAGE, mav.MAV_CMD_SET_MESSAGE_INTERVAL


def flying(system_id: int = 7, **autopilot: object) -> FakeAutopilot:
    """It streams what the daemon before has asked for; its HEARTBEAT was sent just now."""
    made = FakeAutopilot(system_id=system_id, rates_hz={ATTITUDE: ATTITUDE_HZ}, **autopilot)  # type: ignore[arg-type]
    made.step(3_000_000_000)
    made.outgoing()
    return made


def commands(data: bytes) -> list[tuple[int, int, int]]:
    """Target system, command and first parameter of each COMMAND_LONG."""
    said = [msg for msg in Framer(None).feed(data) if msg.get_type() == "COMMAND_LONG"]
    return [(msg.target_system, msg.command, int(msg.param1)) for msg in said]


def attitude(system_id: int, boot_ns: int = 5_000_000_000) -> bytes:
    autopilot = flying(system_id)
    autopilot.step(boot_ns)
    data = autopilot.outgoing()
    return b"".join(msg.get_msgbuf() for msg in Framer(None).feed(data) if msg.get_type() == "ATTITUDE")


def test_an_autopilot_that_a_daemon_left_is_asked_for_its_heartbeat_as_soon_as_it_speaks():
    talking = Conversation(MavlinkSession(SessionSettings(left_system_id=7)), flying())
    talking.run(0.15)
    assert [e.system_id for e in talking.events if isinstance(e, LinkChanged)][:1] == [7]
    assert any(isinstance(e, OriginChanged) for e in talking.events)


def test_without_one_its_heartbeat_is_waited_for():
    talking = Conversation(MavlinkSession(SessionSettings()), flying())
    talking.run(0.8)
    assert talking.events == []
    talking.run(0.4)
    assert isinstance(talking.events[0], LinkChanged)


def test_only_the_one_that_was_left_is_asked_and_not_at_each_word():
    session = MavlinkSession(SessionSettings(left_system_id=7))
    now_ns = 1_000_000_000
    assert session.receive(attitude(8), now_ns) == []
    assert commands(session.outgoing()) == []
    assert session.n_vouched == 0
    for n in range(20):
        assert session.receive(attitude(7), now_ns + n * 20_000_000) == []
    assert commands(session.outgoing()) == [(7, REQUEST, mav.MAVLINK_MSG_ID_HEARTBEAT)] * 2  # in 0.38 s
    assert session.n_vouched == 20


def test_the_first_that_sends_a_heartbeat_is_listened_to_all_the_same():
    """The vehicle may have been given another number within the two minutes."""
    talking = Conversation(MavlinkSession(SessionSettings(left_system_id=7)), FakeAutopilot(system_id=8))
    talking.run(2.0)
    assert talking.session.link.system_id == 8
    assert {beat.get_srcSystem() for beat in talking.autopilot.heartbeats} == {8}


def test_a_system_that_the_configuration_names_is_not_taken_for_another():
    session = MavlinkSession(SessionSettings(system_id=8, left_system_id=7))
    session.receive(attitude(7), 1_000_000_000)
    assert commands(session.outgoing()) == []
    session.receive(attitude(8), 1_000_000_000)
    assert commands(session.outgoing()) == [(8, REQUEST, mav.MAVLINK_MSG_ID_HEARTBEAT)]


@pytest.mark.parametrize(
    ("kind", "status"),
    [(AutopilotKind.ARDUPILOT, mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT), (AutopilotKind.PX4, mav.MAVLINK_MSG_ID_ESTIMATOR_STATUS)],
)
def test_what_a_first_position_needs_is_asked_first_each_question_upon_the_answer(kind: AutopilotKind, status: int):
    session, autopilot = MavlinkSession(SessionSettings()), FakeAutopilot(kind=kind, system_id=7)
    asked = list[tuple[int, int, int]]()
    autopilot.step(3_000_000_000)
    for _ in range(4):  # no time passes, and nobody polls
        session.receive(autopilot.outgoing(), 1_000_000_000)
        data = session.outgoing()
        asked += commands(data)
        autopilot.receive(data)
    wanted = (mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, status, mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    assert asked == [(7, REQUEST, number) for number in wanted]


def test_an_autopilot_that_was_lost_is_asked_when_it_speaks_again():
    talking = Conversation(MavlinkSession(SessionSettings()), flying())
    talking.run(2.0)
    talking.session.disconnected("the cable came out", talking.now_ns)
    talking.session.outgoing()
    talking.session.receive(attitude(7), talking.now_ns)
    assert commands(talking.session.outgoing()) == [(7, REQUEST, mav.MAVLINK_MSG_ID_HEARTBEAT)]
