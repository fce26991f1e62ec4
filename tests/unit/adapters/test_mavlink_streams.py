"""Message rates: asked for, verified, asked for again; and switching the position source."""

import pytest

from visloc_companion.adapters.mavlink.commands import CommandQueue, Question
from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.adapters.mavlink.streams import StreamKeeper, StreamState
from visloc_companion.testing.conversation import Conversation
from visloc_companion.testing.fake_autopilot import Behaviour, FakeAutopilot
from visloc_companion.types import Attitude, AutopilotKind, EkfSource, RequestMessage, SourceSwitched, SwitchSource

ATTITUDE = mav.MAVLINK_MSG_ID_ATTITUDE
GPS = mav.MAVLINK_MSG_ID_GPS_RAW_INT


def talk(kind: AutopilotKind = AutopilotKind.ARDUPILOT, **behaviour: object) -> Conversation:
    autopilot = FakeAutopilot(kind=kind, behaviour=Behaviour(**behaviour))  # type: ignore[arg-type]
    return Conversation(MavlinkSession(SessionSettings()), autopilot)


def test_rates_are_asked_for_and_verified():
    talking = talk()
    talking.session.request(RequestMessage(ATTITUDE, 50.0), talking.now_ns)
    talking.session.request(RequestMessage(GPS, 5.0), talking.now_ns)
    talking.run(2.0)
    assert talking.session.stream_state(ATTITUDE) is StreamState.PENDING
    talking.run(3.5)
    assert talking.session.stream_state(ATTITUDE) is StreamState.ARRIVING
    assert talking.session.stream_state(GPS) is StreamState.ARRIVING
    assert talking.autopilot.rates_hz == pytest.approx({ATTITUDE: 50.0, GPS: 5.0})


def test_a_rate_that_was_acknowledged_and_lost_is_asked_for_again():
    """ArduPilot before it is ready."""
    talking = talk(deaf_requests=2)
    talking.session.request(RequestMessage(ATTITUDE, 50.0), talking.now_ns)
    talking.run(16.0, until=lambda: talking.session.stream_state(ATTITUDE) is StreamState.ARRIVING)
    assert talking.session.stream_state(ATTITUDE) is StreamState.ARRIVING


def test_a_stream_that_stops_later_is_asked_for_again():
    talking = talk()
    talking.session.request(RequestMessage(ATTITUDE, 50.0), talking.now_ns)
    talking.run(6.0)
    talking.autopilot.rates_hz.clear()
    events = talking.run(8.0)
    assert sum(isinstance(e, Attitude) for e in events) > 100


def test_a_denied_rate_is_lowered_until_it_is_granted():
    """ArduPlane denies more than 40 Hz."""
    talking = talk(deny_above_hz=40.0)
    talking.session.request(RequestMessage(ATTITUDE, 50.0), talking.now_ns)
    talking.run(6.0)
    assert talking.autopilot.rates_hz[ATTITUDE] == pytest.approx(37.5, rel=1e-3)
    assert talking.session.stream_state(ATTITUDE) is StreamState.ARRIVING
    assert talking.session.warnings() == ["the autopilot denies ATTITUDE at 50 Hz, asking for 37.5 Hz"]


def test_a_much_lower_rate_streams_but_does_not_count_as_the_one_that_was_asked():
    talking = talk(deny_above_hz=4.0)
    talking.session.request(RequestMessage(ATTITUDE, 50.0), talking.now_ns)
    events = talking.run(10.0)
    assert sum(isinstance(e, Attitude) for e in events) > 10
    assert talking.session.stream_state(ATTITUDE) is StreamState.MISSING


def test_a_message_that_never_comes_is_missing_with_one_warning_and_slows_down():
    talking = talk()
    talking.session.request(RequestMessage(mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT, 2.0), talking.now_ns)
    talking.run(60.0)
    assert talking.session.stream_state(mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT) is StreamState.MISSING
    assert len([w for w in talking.session.warnings() if "EKF_STATUS_REPORT" in w]) == 1


@pytest.mark.parametrize("result", [mav.MAV_RESULT_ACCEPTED, mav.MAV_RESULT_UNSUPPORTED])
def test_a_message_that_never_comes_is_asked_for_every_ten_seconds_all_day(result: int):
    queue = CommandQueue(0.7, 197)
    keeper = StreamKeeper(queue, 3.0)
    keeper.want(RequestMessage(mav.MAVLINK_MSG_ID_DISTANCE_SENSOR, 10.0), 0)
    n_asked = 0
    for t_s in range(0, 24 * 3600):
        now_ns = t_s * 1_000_000_000
        keeper.poll(now_ns)
        asked, _ = queue.poll(1, now_ns)
        if asked is not None:
            n_asked += 1
            answer = queue.acknowledged(mav.MAVLink_command_ack_message(asked.command, result), 1, now_ns)
            assert answer is not None
            keeper.answered(answer, now_ns)
    assert n_asked == pytest.approx(24 * 3600 / 10, rel=0.3)
    assert len(keeper.warnings) == 1


def test_a_local_position_is_not_missed_before_there_is_an_origin():
    """ArduPilot sends none until its estimator has a position, half a minute after boot."""
    talking = talk()
    origin, talking.autopilot.origin = talking.autopilot.origin, None
    local = mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED
    talking.session.request(RequestMessage(local, 10.0), talking.now_ns)
    talking.run(60.0)
    assert talking.session.stream_state(local) is StreamState.PENDING
    assert talking.session.warnings() == []
    talking.autopilot.origin = origin
    talking.run(60.0)
    assert talking.session.stream_state(local) is StreamState.MISSING
    assert len([w for w in talking.session.warnings() if "LOCAL_POSITION_NED" in w]) == 1


def test_nor_while_the_autopilot_says_that_it_has_lost_its_position():
    """After a link that was away for a minute the log said that the message is missing: ArduPilot stops it without a position."""
    talking, voice = talk(), mav.MAVLink(None, 1, 1)
    local = mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED
    talking.session.request(RequestMessage(local, 10.0), talking.now_ns)

    def says(flags: int, seconds: int, *, sent: bool) -> list[str]:
        """What is warned of while it says so of itself, with ten local positions a second or none."""
        for _ in range(10 * seconds):
            t_ms = (talking.now_ns - talking.boot_offset_ns) // 1_000_000
            report = mav.MAVLink_ekf_status_report_message(flags, 0.1, 0.1, 0.1, 0.1, 0.0)
            place = mav.MAVLink_local_position_ned_message(t_ms, 1.0, 2.0, -3.0, 0.0, 0.0, 0.0)
            for message in (report, place) if sent else (report,):
                talking.session.receive(message.pack(voice), talking.now_ns)
            talking.run(0.1)
        return [text for text in talking.session.warnings() if "LOCAL_POSITION_NED" in text]

    assert says(0x33F, 10, sent=True) == []
    assert talking.session.stream_state(local) is StreamState.ARRIVING
    assert says(0xA7, 60, sent=False) == []
    assert talking.session.stream_state(local) is StreamState.PENDING
    assert says(0x33F, 20, sent=True) == []
    assert talking.session.stream_state(local) is StreamState.ARRIVING
    assert len(says(0x33F, 60, sent=False)) == 1


def test_after_a_minute_of_silence_every_stream_is_asked_for_again():
    """The autopilot was switched off meanwhile, and has forgotten them."""
    talking = talk()
    talking.session.request(RequestMessage(ATTITUDE, 20.0), talking.now_ns)
    talking.run(10.0)
    talking.autopilot.behaviour.silent = True
    talking.run(60.0)
    assert not talking.session.link.up
    talking.autopilot.reboot()
    talking.boot_offset_ns = talking.now_ns
    talking.autopilot.behaviour.silent = False
    events = talking.run(3.0)
    assert sum(isinstance(event, Attitude) for event in events) > 20


def test_a_refused_message_is_missing_at_once():
    talking = talk()
    talking.session.request(RequestMessage(60_000, 2.0), talking.now_ns)
    talking.run(2.0)
    assert talking.session.stream_state(60_000) is StreamState.MISSING
    assert talking.session.stream_state(61_000) is StreamState.MISSING  # nobody asked


def test_zero_hertz_asks_once():
    talking = talk()
    talking.run(2.0)
    talking.session.request(RequestMessage(GPS, 0.0), talking.now_ns)
    events = talking.run(5.0)
    assert talking.session.stream_state(GPS) is StreamState.ARRIVING
    assert len([e for e in events if type(e).__name__ == "Gnss"]) == 1


def test_a_message_that_is_asked_for_once_and_does_not_come_is_missed_in_these_words():
    """`GPS_GLOBAL_ORIGIN arrives at 0.0 Hz instead of 0 Hz`."""
    queue = CommandQueue(0.7, 197)
    keeper = StreamKeeper(queue, 3.0)
    keeper.want(RequestMessage(mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, 0.0), 0)
    for now_ns in range(0, 60_000_000_000, 500_000_000):
        keeper.poll(now_ns)
        if (asked := queue.poll(1, now_ns)[0]) is not None:
            answer = queue.acknowledged(mav.MAVLink_command_ack_message(asked.command, mav.MAV_RESULT_ACCEPTED), 1, now_ns)
            assert answer is not None
            keeper.answered(answer, now_ns)
    assert keeper.warnings == ["GPS_GLOBAL_ORIGIN was asked for and does not come"]


def test_an_acknowledgement_for_another_companion_is_not_ours():
    queue = CommandQueue(ack_timeout_s=0.5, component_id=197)
    queue.ask(Question("a", 511, (30.0, 20000.0)))
    assert queue.poll(1, 0)[0] is not None
    for system, component in ((255, 190), (1, 191)):
        assert queue.acknowledged(mav.MAVLink_command_ack_message(511, 2, 0, 0, system, component), 1, 1) is None
    assert queue.acknowledged(mav.MAVLink_command_ack_message(512, 0, 0, 0, 1, 197), 1, 1) is None
    answer = queue.acknowledged(mav.MAVLink_command_ack_message(511, 0, 0, 0, 1, 197), 1, 1)
    assert answer is not None
    assert (answer.question.key, answer.result) == ("a", 0)


def test_work_in_progress_and_temporary_rejection_wait():
    queue = CommandQueue(ack_timeout_s=0.5, component_id=197)
    queue.ask(Question("a", 42007, (2.0,), tries=3))
    queue.poll(1, 0)
    assert queue.acknowledged(mav.MAVLink_command_ack_message(42007, 5), 1, 400_000_000) is None
    assert queue.poll(1, 600_000_000) == (None, None)
    assert queue.acknowledged(mav.MAVLink_command_ack_message(42007, 1), 1, 700_000_000) is None
    again, given_up = queue.poll(1, 1_000_000_000)
    assert (again.confirmation, given_up) == (1, None)


# ------------------------------------------------------------------------------------------------------------ switching


def switched(events: list[object]) -> list[SourceSwitched]:
    return [e for e in events if isinstance(e, SourceSwitched)]


def test_ardupilot_switches_by_command():
    talking = talk()
    talking.run(2.0)
    talking.session.switch(SwitchSource(EkfSource.VISION), talking.now_ns)
    (event,) = switched(talking.run(1.0))
    assert (event.source, event.accepted, talking.autopilot.source_set) == (EkfSource.VISION, True, 2)
    talking.session.switch(SwitchSource(EkfSource.GNSS), talking.now_ns)
    (event,) = switched(talking.run(1.0))
    assert (event.source, event.accepted, talking.autopilot.source_set) == (EkfSource.GNSS, True, 1)


def test_px4_switches_by_an_integer_parameter():
    talking = talk(AutopilotKind.PX4)
    talking.run(2.0)
    talking.session.switch(SwitchSource(EkfSource.VISION), talking.now_ns)
    assert switched(talking.run(1.0))[0].accepted
    assert talking.autopilot.params["EKF2_GPS_CTRL"] == 0
    talking.session.switch(SwitchSource(EkfSource.GNSS), talking.now_ns)
    assert switched(talking.run(1.0))[0].accepted
    assert talking.autopilot.params["EKF2_GPS_CTRL"] == 7


@pytest.mark.parametrize("kind", [AutopilotKind.ARDUPILOT, AutopilotKind.PX4])
def test_a_switch_without_answer_is_tried_three_times_then_given_up(kind):
    talking = talk(kind)
    talking.run(2.0)
    talking.autopilot.behaviour.mute_commands = True
    talking.session.switch(SwitchSource(EkfSource.VISION), talking.now_ns)
    (event,) = switched(talking.run(8.0))
    assert (event.accepted, event.answered) == (False, False)
    assert "3 tries" in event.detail


@pytest.mark.parametrize("kind", [AutopilotKind.ARDUPILOT, AutopilotKind.PX4])
def test_a_refused_switch_is_not_taken_for_a_confirmed_one(kind):
    talking = talk(kind, answers_switch=mav.MAV_RESULT_DENIED)
    talking.run(2.0)
    talking.session.switch(SwitchSource(EkfSource.VISION), talking.now_ns)
    (event,) = switched(talking.run(8.0))
    assert not event.accepted
    assert event.answered is (kind is AutopilotKind.ARDUPILOT), "PX4 does not say that it will not"
    assert talking.autopilot.source_set == 1
    assert talking.autopilot.params["EKF2_GPS_CTRL"] == 7


def test_a_switch_goes_before_waiting_rate_requests():
    talking = talk()
    talking.run(2.0)
    for message_id in (24, 30, 32, 33, 193, 230, 132, 29):
        talking.session.request(RequestMessage(message_id, 1.0), talking.now_ns)
    talking.session.switch(SwitchSource(EkfSource.VISION), talking.now_ns)
    assert switched(talking.run(0.3))


def test_a_switch_that_cannot_be_ends_at_once_with_its_reason():
    talking = talk()
    talking.session.switch(SwitchSource(EkfSource.VISION), talking.now_ns)
    (event,) = switched(talking.run(0.1))
    assert not event.accepted
    assert "no link" in event.detail


def test_a_newer_switch_supersedes_and_a_lost_link_ends_it():
    talking = talk()
    talking.run(2.0)
    talking.autopilot.behaviour.mute_commands = True
    talking.session.switch(SwitchSource(EkfSource.VISION), talking.now_ns)
    talking.session.switch(SwitchSource(EkfSource.GNSS), talking.now_ns)
    (event,) = switched(talking.run(0.1))
    assert (event.source, event.accepted) == (EkfSource.VISION, False)
    talking.autopilot.behaviour.silent = True
    (event,) = switched(talking.run(5.0))
    assert (event.source, event.accepted, event.answered) == (EkfSource.GNSS, False, False)
