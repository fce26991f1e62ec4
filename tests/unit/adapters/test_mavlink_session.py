"""The conversation with an autopilot: identity, pinning, time, origin, link up and down."""

import pytest

from tests.unit.adapters.session_talk import ORIGIN, injection, talk
from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import CompanionState, SessionSettings
from visloc_companion.errors import Reason
from visloc_companion.testing.conversation import Conversation
from visloc_companion.testing.fake_autopilot import Behaviour, FakeAutopilot
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    GeoPoint,
    LinkChanged,
    Notice,
    OriginChanged,
    Report,
    RequestMessage,
    Severity,
    TimesyncSample,
)

ATTITUDE = mav.MAVLINK_MSG_ID_ATTITUDE


def links(events: list[object]) -> list[LinkChanged]:
    return [event for event in events if isinstance(event, LinkChanged)]


@pytest.mark.parametrize(("kind", "version"), [(AutopilotKind.ARDUPILOT, "4.6.3"), (AutopilotKind.PX4, "1.16.0")])
def test_kind_version_and_system_are_detected(kind, version):
    talking = talk(kind=kind, system_id=7)
    talking.run(3.0)
    last = links(talking.events)[-1]
    assert (last.up, last.autopilot, last.version, last.system_id) == (True, kind, version, 7)
    assert len(links(talking.events)) == 2  # up, then with its version: repeated heartbeats say nothing new


def test_heartbeats_are_those_of_a_companion_of_the_vehicle_at_1_hz():
    talking = talk(system_id=7)
    talking.run(10.0)
    beats = talking.autopilot.heartbeats
    ours = [(b.get_srcSystem(), b.get_srcComponent(), b.type, b.autopilot, b.system_status) for b in beats[1:]]
    assert set(ours) == {(7, 197, 18, 8, mav.MAV_STATE_STANDBY)}
    assert 9 <= len(beats) <= 11
    assert all(beat.get_msgbuf()[0] == 0xFD for beat in beats)


def test_the_heartbeat_is_active_while_injections_flow_and_as_it_is_set():
    talking = talk()
    talking.run(2.0)
    talking.session.send(injection(talking.now_ns), talking.now_ns)
    talking.run(1.1)
    assert talking.autopilot.heartbeats[-1].system_status == mav.MAV_STATE_ACTIVE
    talking.run(4.0)
    assert talking.autopilot.heartbeats[-1].system_status == mav.MAV_STATE_STANDBY
    talking.session.set_state(CompanionState.CRITICAL)
    talking.run(1.1)
    assert talking.autopilot.heartbeats[-1].system_status == mav.MAV_STATE_CRITICAL


def test_a_second_autopilot_is_ignored_with_one_warning():
    talking = talk(system_id=1)
    talking.run(2.0)
    other = FakeAutopilot(system_id=2, origin=GeoPoint(10.0, 10.0, 0.0))
    other.rates_hz[ATTITUDE] = 50.0
    talking.session.warnings()
    events = []
    for i in range(300):
        other.step(i * 10_000_000)
        events += talking.session.receive(other.outgoing(), talking.now_ns)
    assert events == []
    assert [w for w in talking.session.warnings() if "second autopilot (system 2)" in w]
    assert talking.session.link.system_id == 1
    assert talking.session.origin == ORIGIN
    other.step(4_000_000_000)
    talking.session.receive(other.outgoing(), talking.now_ns)
    assert talking.session.warnings() == []


def test_a_configured_system_id_waits_for_that_autopilot():
    talking = Conversation(MavlinkSession(SessionSettings(system_id=3)), FakeAutopilot(system_id=1))
    assert links(talking.run(3.0)) == []
    talking.autopilot = FakeAutopilot(system_id=3)
    assert links(talking.run(2.0))[0].system_id == 3


@pytest.mark.parametrize("kind", [mav.MAV_TYPE_GCS, mav.MAV_TYPE_ONBOARD_CONTROLLER, mav.MAV_TYPE_GIMBAL])
def test_a_ground_station_or_companion_is_never_pinned(kind):
    session = MavlinkSession(SessionSettings())
    peer = FakeAutopilot(system_id=255)
    peer.send(mav.MAVLink_heartbeat_message(kind, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3))
    assert session.receive(peer.outgoing(), 0) == []
    assert not session.link.up


def test_timesync_requests_are_answered_in_the_same_call():
    talking = talk(kind=AutopilotKind.PX4)
    talking.run(2.0)
    talking.session.outgoing()
    talking.autopilot.send(mav.MAVLink_timesync_message(0, 123_456_789))
    talking.session.receive(talking.autopilot.outgoing(), talking.now_ns)
    talking.autopilot.receive(talking.session.outgoing())
    reply = talking.autopilot.timesync_replies[-1]
    assert (reply.tc1, reply.ts1) == (talking.now_ns, 123_456_789)


def test_own_timesync_requests_give_samples_of_the_true_offset():
    talking = talk()
    talking.run(5.0)
    samples = [e for e in talking.events if isinstance(e, TimesyncSample)]
    assert len(samples) >= 12
    for sample in samples:
        middle_ns = (sample.t_sent_ns + sample.t_rx_ns) // 2
        assert abs((middle_ns - sample.t_remote_ns) - talking.boot_offset_ns) <= 20_000_000
        assert sample.t_sent_ns <= sample.t_rx_ns


def test_a_timesync_reply_to_somebody_else_is_no_sample():
    talking = talk()
    talking.run(2.0)
    talking.autopilot.send(mav.MAVLink_timesync_message(55, 424_242))
    events = talking.session.receive(talking.autopilot.outgoing(), talking.now_ns)
    assert events == []


def test_nothing_is_injected_before_the_origin_is_known():
    talking = talk(origin=None)
    talking.run(3.0)
    assert not talking.session.send(injection(talking.now_ns), talking.now_ns)
    talking.run(0.1)
    assert talking.autopilot.poses == []
    assert talking.session.refused[Reason.NO_ORIGIN] == 1
    assert any("origin" in warning for warning in talking.session.warnings())
    talking.autopilot.origin = ORIGIN
    events = talking.run(2.5)
    assert [e.origin for e in events if isinstance(e, OriginChanged)] == [ORIGIN]
    assert talking.session.send(injection(talking.now_ns, reset_counter=257), talking.now_ns)
    talking.run(0.1)
    pose = talking.autopilot.poses[0]
    assert (pose.x, pose.y, pose.z, pose.reset_counter) == (10.0, -3.0, -42.0, 1)
    assert pose.usec * 1000 == talking.now_ns - 100_000_000


def test_a_moved_origin_is_noticed():
    talking = talk()
    talking.run(3.0)
    talking.autopilot.origin = GeoPoint(47.4, 8.6, 500.0)
    events = talking.run(6.0)
    assert [e.origin for e in events if isinstance(e, OriginChanged)] == [talking.autopilot.origin]


def test_injections_with_wrong_numbers_or_time_are_refused():
    talking = talk()
    talking.run(2.0)
    now_ns = talking.now_ns
    assert talking.session.send(injection(now_ns), now_ns)
    assert not talking.session.send(injection(now_ns - 1), now_ns)
    later_ns = now_ns + 30_000_000
    assert not talking.session.send(injection(later_ns, north_m=float("nan")), later_ns)
    assert not talking.session.send(injection(later_ns, north_m=1e9), later_ns)
    assert dict(talking.session.refused) == {Reason.IMPLAUSIBLE_TIME: 1, Reason.NOT_FINITE: 1, Reason.BAD_INPUT: 1}
    assert len(talking.session.warnings()) >= 3


def test_silence_takes_the_link_down_and_a_heartbeat_brings_it_up_with_everything_asked_anew():
    talking = talk()
    talking.session.request(RequestMessage(ATTITUDE, 20.0), talking.now_ns)
    talking.run(3.0)
    talking.autopilot.behaviour.silent = True
    events = talking.run(4.0)
    assert [link.up for link in links(events)] == [False]
    assert talking.session.origin is None
    assert not talking.session.send(injection(talking.now_ns), talking.now_ns)
    talking.autopilot.reboot()
    talking.autopilot.behaviour.silent = False
    events = talking.run(4.0)
    assert links(events)[0].up
    assert any(isinstance(e, OriginChanged) for e in events)
    assert sum(isinstance(e, Attitude) for e in events) > 40


def test_a_lost_connection_takes_the_link_down_at_once():
    talking = talk()
    talking.run(2.0)
    events = talking.session.disconnected("unplugged", talking.now_ns)
    assert [link.up for link in links(events)] == [False]
    assert talking.session.disconnected("again", talking.now_ns) == []
    assert talking.session.warnings() == ["unplugged", "again"]


def test_a_stall_of_our_own_is_not_held_against_the_autopilot():
    talking = talk()
    talking.run(2.0)
    talking.now_ns += 10_000_000_000
    assert links(talking.session.poll(talking.now_ns)) == []
    assert talking.session.link.up
    talking.autopilot.behaviour.silent = True
    assert [link.up for link in links(talking.run(4.0))] == [False]


def test_a_restart_of_the_autopilot_without_silence_is_noticed():
    talking = talk()
    talking.session.request(RequestMessage(ATTITUDE, 20.0), talking.now_ns)
    talking.run(10.0)
    talking.autopilot.reboot()
    talking.autopilot.rates_hz[ATTITUDE] = 20.0
    talking.boot_offset_ns = talking.now_ns
    events = talking.run(3.0)
    assert [link.up for link in links(events)] == [False, True]
    assert any("restarted" in warning for warning in talking.session.warnings())


def test_a_restarted_autopilot_that_was_not_silent_is_asked_for_its_streams_at_once():
    """It has forgotten the rates; all that it says by itself are heartbeats, and what its clock shows."""
    talking = talk()
    talking.session.request(RequestMessage(ATTITUDE, 20.0), talking.now_ns)
    talking.run(10.0)
    talking.autopilot.reboot()
    talking.boot_offset_ns = talking.now_ns
    assert [link.up for link in links(talking.run(0.5))][:1] == [False]
    events = talking.run(1.5)
    assert sum(isinstance(e, Attitude) for e in events) > 10


def test_an_attitude_that_is_said_in_two_messages_is_one():
    """PX4's onboard streams hold ATTITUDE and ATTITUDE_QUATERNION of the same instants."""
    talking = talk(kind=AutopilotKind.PX4)
    talking.run(2.0)
    voice = mav.MAVLink(None, 1, 1)
    said: list[Attitude] = []
    for t_ms in (5000, 5020, 5040):
        for message in (
            mav.MAVLink_attitude_message(t_ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            mav.MAVLink_attitude_quaternion_message(t_ms, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        ):
            said += [e for e in talking.session.receive(message.pack(voice), talking.now_ns) if isinstance(e, Attitude)]
    assert [attitude.t_boot_ns for attitude in said] == [5_000_000_000, 5_020_000_000, 5_040_000_000]


def test_a_few_stray_bytes_are_no_damage_and_a_wrong_baud_rate_is():
    """ArduPilot prints some characters on its ports when it boots."""
    talking = talk()
    talking.session.receive(b"0 0 0 ", talking.now_ns)
    talking.run(5.0)
    assert talking.session.warnings() == []
    for _ in range(100):
        talking.session.receive(bytes(range(200)), talking.now_ns)
    assert [w for w in talking.session.warnings() if "are not MAVLink" in w] == [
        "bytes on the link are not MAVLink (wrong baud rate, noise, or another protocol?); they are skipped"
    ]


def test_time_that_goes_backwards_is_held():
    talking = talk()
    talking.session.request(RequestMessage(ATTITUDE, 20.0), talking.now_ns)
    talking.run(3.0)
    late_ns = talking.now_ns
    talking.autopilot.step(late_ns - talking.boot_offset_ns + 100_000_000)
    events = talking.session.receive(talking.autopilot.outgoing(), late_ns - 10_000_000_000)
    assert events
    assert all(event.t_rx_ns == late_ns for event in events)


def test_texts_for_the_operator_only_long_ones_in_pieces():
    talking = talk()
    talking.session.notify(Notice(Severity.INFO, "for the log"), talking.now_ns)
    talking.session.notify(Notice(Severity.CRITICAL, "vision lost ° " + "x" * 60, to_operator=True), talking.now_ns)
    talking.run(0.1)
    text = "vision lost ? " + "x" * 60
    assert talking.autopilot.texts == [text[:50], text[50:]]


def test_texts_that_nobody_heard_are_said_when_the_autopilot_is_heard():
    """A full disk at the start, a localiser that fails while the link is away: said once, and the operator must know."""

    def say(text: str) -> None:
        talking.session.notify(Notice(Severity.WARNING, text, to_operator=True), talking.now_ns)

    talking = talk()
    say("no journal")
    talking.session.report(Report(talking.now_ns, (("VL_PL", 3.5),)), talking.now_ns)
    sent = mav.MAVLink(None).parse_buffer(talking.session.outgoing()) or []
    assert {message.get_type() for message in sent} <= {"HEARTBEAT"}, "nobody knows yet whose companion this is"
    talking.run(2.0)
    assert talking.autopilot.texts == ["no journal"]
    say("heard")
    talking.run(1.0)
    talking.autopilot.behaviour.silent = True
    talking.run(0.5)
    talking.session.outgoing()
    for text in ("before the silence is noticed", "localiser failed", "localiser failed"):
        say(text)
        talking.session.outgoing()
        talking.run(2.0)
    talking.autopilot.texts.clear()
    talking.autopilot.behaviour.silent = False
    talking.run(2.0)
    assert talking.autopilot.texts == ["before the silence is noticed", "localiser failed", "localiser failed"]
    talking.session.disconnected("unplugged", talking.now_ns)
    talking.run(2.0)
    assert len(talking.autopilot.texts) == 3


def test_a_critical_report_shows_in_the_heartbeat_until_the_next():
    talking = talk()
    talking.run(1.2)
    for critical, state in ((True, mav.MAV_STATE_CRITICAL), (False, mav.MAV_STATE_STANDBY)):
        talking.session.report(Report(talking.now_ns, (("VL_PL", 3.5),), critical=critical), talking.now_ns)
        talking.run(1.2)
        assert talking.autopilot.heartbeats[-1].system_status == state
    assert [(message.name, message.value) for message in talking.autopilot.told] == [("VL_PL", 3.5)] * 2


def test_nobody_drains_and_memory_stays_bounded():
    session = MavlinkSession(SessionSettings(system_id=1))
    for i in range(20_000):
        session.notify(Notice(Severity.INFO, f"{i:050d}", to_operator=True), i)
    assert len(session.outgoing()) <= 65_536


def test_messages_that_hold_nan_are_counted_and_dropped():
    talking = talk()
    talking.run(2.0)
    talking.autopilot.send(mav.MAVLink_attitude_message(5000, float("nan"), 0, 0, 0, 0, 0))
    assert talking.session.receive(talking.autopilot.outgoing(), talking.now_ns) == []
    assert talking.session.dropped["ATTITUDE", Reason.NOT_FINITE] == 1


def test_requests_go_on_when_commands_get_no_answer():
    talking = talk(behaviour=Behaviour(mute_commands=True))
    talking.session.request(RequestMessage(ATTITUDE, 20.0), talking.now_ns)
    talking.run(10.0)
    talking.autopilot.behaviour.mute_commands = False
    events = talking.run(10.0)
    assert any(isinstance(e, OriginChanged) for e in events)
    assert sum(isinstance(e, Attitude) for e in events) > 10
