"""Which message a session sends its positions in, what it tells of the choice, and what it does not listen to."""

import math
from dataclasses import replace

import pytest

from tests.unit.adapters.session_talk import ORIGIN, injection, talk
from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.outputs.fence import Fence
from visloc_companion.adapters.mavlink.outputs.kinds import Output
from visloc_companion.adapters.mavlink.refusals import REASONS, Refusals
from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.errors import Reason
from visloc_companion.testing.conversation import Conversation
from visloc_companion.testing.fake_autopilot import FakeAutopilot
from visloc_companion.types import AutopilotKind, EkfSource, Gnss, Notice, Severity, SourceSwitched, SwitchSource


def asked_for_quality() -> Conversation:
    """With a PX4 whose parameters are read: it takes ODOMETRY alone."""
    talking = talk(kind=AutopilotKind.PX4, params={"EKF2_EV_CTRL": 1, "EKF2_EV_QMIN": 40})
    talking.run(3.0)
    return talking


def silence(talking: Conversation, for_s: float) -> None:
    """The autopilot says nothing for a while, and then is heard again."""
    talking.autopilot.behaviour.silent = True
    talking.run(for_s)
    talking.autopilot.behaviour.silent = False


def test_the_output_fits_the_parameters_and_is_told_once():
    talking = asked_for_quality()
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
    talking = asked_for_quality()
    silence(talking, 4.0)
    talking.run(1.2)
    assert talking.session.link.up
    assert talking.session.choice.output is Output.ODOMETRY
    talking.autopilot.params["EKF2_EV_QMIN"] = 0
    talking.session.disconnected("unplugged", talking.now_ns)
    talking.run(4.0)
    assert talking.session.choice.output is Output.VISION_POSITION_ESTIMATE


def test_parameters_stay_known_where_the_link_is_lost_and_their_answers_with_it():
    """The link is back for a moment, and away for less than it takes to be called lost: all that was asked meanwhile is gone."""
    talking = asked_for_quality()
    silence(talking, 4.0)
    talking.run(2.0, until=lambda: talking.session.link.up)
    silence(talking, 2.8)
    talking.run(4.0)
    assert talking.session.link.up
    assert talking.session.choice.output is Output.ODOMETRY


@pytest.mark.parametrize("field", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["EKF2_EV_CTRL", "EKF2_AGP0_CTRL"])
def test_a_parameter_that_is_no_number_is_as_if_not_answered(name: str, field: float):
    talking = talk(kind=AutopilotKind.PX4, params={"EKF2_AGP0_ID": 1})
    packer = mav.MAVLink(None, 1, 1)
    for _ in range(8):
        talking.run(0.5)
        told = mav.MAVLink_param_value_message(name.encode(), field, mav.MAV_PARAM_TYPE_REAL32, 1, 0)
        talking.session.receive(told.pack(packer), talking.now_ns)
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
    assert talking.session.n_sent == 5, "not the hundred that were given"
    talking.session.switch(SwitchSource(EkfSource.VISION), talking.now_ns)
    ended = [event for event in talking.run(1.0) if isinstance(event, SourceSwitched)]
    assert [(event.accepted, event.shows_use) for event in ended] == [(True, False)]


def fenced() -> Conversation:
    """Within a fence whose northern edge lies 40 m south of the origin."""
    edge_deg = ORIGIN.lat_deg - 40.0 / 111_000.0
    fence = Fence(ORIGIN.lat_deg - 1, ORIGIN.lon_deg - 1, edge_deg, ORIGIN.lon_deg + 1, 0.0)
    talking = Conversation(MavlinkSession(SessionSettings(fence=fence)), FakeAutopilot())
    talking.run(4.0)
    return talking


def fly(talking: Conversation, for_s: float, north_m: float = 10.0) -> list[bool]:
    """Ten positions a second, and which of them were sent."""
    sent = []
    for _ in range(round(for_s * 10)):
        talking.run(0.1)
        sent.append(talking.session.send(injection(talking.now_ns, north_m=north_m), talking.now_ns))
    talking.run(0.1)
    return sent


def test_the_operator_is_told_that_positions_are_kept_back_and_that_they_are_sent_again():
    """They ended beyond the map's fence while the ground station showed AIDING: only the log said so."""
    talking = fenced()
    assert not any(fly(talking, 0.8))
    assert talking.autopilot.texts == [], "it may be over at once"
    assert not any(fly(talking, 3.0))
    assert talking.session.withheld == "too far outside the map"
    assert talking.autopilot.texts == ["visloc NOT SENT: too far outside the map"]
    assert all(fly(talking, 1.0, north_m=-60.0))
    assert talking.session.withheld == ""
    assert talking.autopilot.texts[1:] == ["visloc: positions are sent again"]
    assert not any(fly(talking, 2.0))
    assert talking.autopilot.texts[2:] == ["visloc NOT SENT: too far outside the map"]


def test_single_positions_that_are_kept_back_are_the_logs_affair():
    talking = fenced()
    for _ in range(6):
        fly(talking, 0.2)
        fly(talking, 0.2, north_m=-60.0)
        talking.run(2.0)
    assert talking.autopilot.texts == []
    assert len([text for text in talking.session.warnings() if "further outside the map" in text]) == 1


@pytest.mark.parametrize("reason", [reason for reason in Reason if reason in REASONS])
def test_each_reason_fits_into_one_text(reason: Reason):
    said: list[Notice] = []
    refusals = Refusals(lambda text: None, said.append)
    for k in range(12):
        refusals.refused(reason, k * 100_000_000)
    (notice,) = said
    assert (len(notice.text) <= 50, notice.to_operator, notice.severity) == (True, True, Severity.CRITICAL)
    assert refusals.counts[reason] == 12


def test_a_pause_in_which_none_were_to_be_sent_does_not_count():
    said: list[Notice] = []
    refusals = Refusals(lambda text: None, said.append)
    for t_s in (0.0, 0.5, 10.0, 10.5, 60.0):
        refusals.refused(Reason.TOO_OLD, round(t_s * 1e9))
    assert said == []
    refusals.refused(Reason.TOO_OLD, round(60.9e9))
    refusals.refused(Reason.NO_ORIGIN, round(61.1e9))
    assert [notice.text for notice in said] == ["visloc NOT SENT: EKF origin not known"]
