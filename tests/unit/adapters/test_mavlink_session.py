"""The conversation with an autopilot: identity, pinning, time, origin, link up and down."""

from dataclasses import replace

import pytest

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.outputs.kinds import Output
from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import CompanionState, SessionSettings
from visloc_companion.errors import Reason
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.testing.conversation import Conversation
from visloc_companion.testing.fake_autopilot import Behaviour, FakeAutopilot
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    EkfSource,
    GeoPoint,
    Gnss,
    Injection,
    LinkChanged,
    Notice,
    OriginChanged,
    Report,
    RequestMessage,
    Severity,
    SourceSwitched,
    SwitchSource,
    TimesyncSample,
)

ATTITUDE = mav.MAVLINK_MSG_ID_ATTITUDE
ORIGIN = GeoPoint(47.3977, 8.5456, 488.0)


def injection(t_ns: int, reset_counter: int = 0, north_m: float = 10.0) -> Injection:
    cov = ((4.0, 0.0), (0.0, 4.0))
    p_ned_m = (north_m, -3.0, -42.0)
    place = geo_from_ned(p_ned_m, ORIGIN) if abs(north_m) < 1e6 else ORIGIN
    return Injection(t_ns, p_ned_m, place, (1.0, 0.0, 0.0, 0.0), cov, 1.0, 0.02, reset_counter)


def talk(**autopilot: object) -> Conversation:
    return Conversation(MavlinkSession(SessionSettings()), FakeAutopilot(**autopilot))  # type: ignore[arg-type]


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


def test_a_critical_report_shows_in_the_heartbeat_until_the_next():
    talking = talk()
    for critical, state in ((True, mav.MAV_STATE_CRITICAL), (False, mav.MAV_STATE_STANDBY)):
        talking.session.report(Report(talking.now_ns, (("VL_PL", 3.5),), critical=critical), talking.now_ns)
        talking.run(1.2)
        assert talking.autopilot.heartbeats[-1].system_status == state
    assert [(message.name, message.value) for message in talking.autopilot.told] == [("VL_PL", 3.5)] * 2


def test_nobody_drains_and_memory_stays_bounded():
    session = MavlinkSession(SessionSettings())
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


def test_the_output_fits_the_parameters_and_is_told_once():
    talking = talk(kind=AutopilotKind.PX4, params={"EKF2_EV_CTRL": 1, "EKF2_EV_QMIN": 40})
    talking.run(3.0)
    assert talking.session.choice.output is Output.ODOMETRY
    for _ in range(3):
        talking.run(0.1)
        what = replace(injection(talking.now_ns), v_ned_mps=(1.0, 0.0, 0.0), cov_v_ne_m2ps2=((1.0, 0.0), (0.0, 1.0)))
        assert talking.session.send(what, talking.now_ns)
    talking.run(0.1)
    assert [message.get_type() for message in talking.autopilot.positions] == ["ODOMETRY"] * 3
    told = [text for text in talking.session.warnings() if "positions are sent" in text]
    assert told == ["positions are sent as ODOMETRY: the autopilot asks for a quality, which only ODOMETRY carries"]


def test_parameters_stay_known_over_a_silence():
    talking = talk(kind=AutopilotKind.PX4, params={"EKF2_EV_CTRL": 1, "EKF2_EV_QMIN": 40})
    talking.run(3.0)
    talking.autopilot.behaviour.silent = True
    talking.run(4.0)
    talking.autopilot.behaviour.silent = False
    talking.run(1.2)
    assert talking.session.link.up
    assert talking.session.choice.output is Output.ODOMETRY
    talking.autopilot.params["EKF2_EV_QMIN"] = 0
    talking.session.disconnected("unplugged", talking.now_ns)
    talking.run(4.0)
    assert talking.session.choice.output is Output.VISION_POSITION_ESTIMATE


def test_what_cannot_be_sent_is_told_to_the_operator_before_the_flight():
    talking = talk(kind=AutopilotKind.PX4, params={"EKF2_EV_CTRL": 0})
    talking.run(4.0)
    assert not talking.session.send(injection(talking.now_ns), talking.now_ns)
    assert [text for text in talking.session.warnings() if "set EKF2_EV_CTRL 1" in text]
    assert talking.autopilot.texts == ["visloc NOT SENT: set EKF2_EV_CTRL 1"]


@pytest.mark.parametrize("ev_ctrl", [0, 1])
def test_an_autopilot_that_can_be_sent_nothing_is_left_on_gnss(ev_ctrl: int):
    talking = talk(kind=AutopilotKind.PX4, params={"EKF2_EV_CTRL": ev_ctrl, "EKF2_GPS_CTRL": 7})
    talking.run(4.0)
    talking.session.switch(SwitchSource(EkfSource.VISION), talking.now_ns)
    ended = [event for event in talking.run(1.0) if isinstance(event, SourceSwitched)]
    assert [event.accepted for event in ended] == [ev_ctrl == 1]
    assert talking.autopilot.params["EKF2_GPS_CTRL"] == (0 if ev_ctrl else 7)
    assert ev_ctrl or "EKF2_EV_CTRL" in ended[0].detail


def test_a_long_remedy_reaches_the_operator_whole():
    talking = Conversation(
        MavlinkSession(SessionSettings(output=Output.GPS_INPUT)), FakeAutopilot(params={"GPS1_TYPE": 1, "GPS2_TYPE": 0})
    )
    talking.run(6.0)
    remedy = f"visloc NOT SENT: {talking.session.choice.remedy}"
    assert len(remedy) > 50
    assert "".join(talking.autopilot.texts) == remedy


def test_the_echo_of_a_receiver_that_we_play_is_not_listened_to():
    """Else the verdict would hold GNSS against our own position."""
    talking = talk(params={"GPS2_TYPE": 14, "EK3_SRC2_POSXY": 3})
    talking.run(3.0)
    assert talking.session.choice.output is Output.GPS_INPUT
    talking.autopilot.send(mav.MAVLink_gps2_raw_message(5_000_000, 3, 1, 1, 1, 90, 120, 0, 0, 10, 0, 0))
    talking.autopilot.send(mav.MAVLink_gps_raw_int_message(5_000_000, 3, 474000000, 85000000, 1000, 90, 120, 0, 0, 10))
    heard = [event for event in talking.run(0.1) if isinstance(event, Gnss)]
    assert [event.receiver for event in heard] == [0]


def test_a_receiver_is_told_the_calendars_time_where_the_autopilot_told_it():
    talking = talk(params={"GPS2_TYPE": 14, "EK3_SRC2_POSXY": 3})
    talking.run(3.0)
    talking.autopilot.send(mav.MAVLink_system_time_message(1_700_000_000_000_000, 5000))
    talking.run(0.1)
    what = replace(injection(talking.now_ns), v_ned_mps=(1.0, 0.0, 0.0), cov_v_ne_m2ps2=((1.0, 0.0), (0.0, 1.0)))
    assert talking.session.send(what, talking.now_ns)
    talking.run(0.1)
    (message,) = talking.autopilot.positions
    assert message.time_week == 2288
    assert abs(message.time_week_ms - 252_818_000) <= 200


def test_estimates_for_dead_reckoning_come_at_their_own_slow_period():
    talking = talk(plane=True, params={"VISO_TYPE": 0})
    talking.run(3.0)
    assert talking.session.choice.output is Output.EXTERNAL_POSITION_ESTIMATE
    for _ in range(100):
        talking.run(0.1)
        talking.session.send(injection(talking.now_ns), talking.now_ns)
    talking.run(0.1)
    assert len(talking.autopilot.positions) == 5
    talking.session.switch(SwitchSource(EkfSource.VISION), talking.now_ns)
    ended = [event for event in talking.run(1.0) if isinstance(event, SourceSwitched)]
    assert [(event.accepted, event.shows_use) for event in ended] == [(True, False)]
