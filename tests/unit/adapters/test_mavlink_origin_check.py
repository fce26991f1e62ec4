"""An EKF origin that moved without our hearing of it: positions of the autopilot tell, and nothing is sent about the old one."""

from dataclasses import replace

import pytest

from tests.unit.adapters.session_talk import ORIGIN, injection, talk
from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.origin_check import OriginCheck
from visloc_companion.errors import Reason
from visloc_companion.geo.wgs84 import autopilot_ned_from_geo, geo_from_autopilot_ned
from visloc_companion.testing.conversation import Conversation
from visloc_companion.types import AutopilotKind, LocalPose, OriginChanged, PriorPose

PX4 = AutopilotKind.PX4
PLACE = geo_from_autopilot_ned(PX4, (60.0, -20.0, -50.0), ORIGIN)
MOVED = geo_from_autopilot_ned(PX4, (300.0, 0.0, 0.0), ORIGIN)


def say_where(talking: Conversation) -> None:
    """The autopilot's own local and global position, which is PLACE, about the origin that it has."""
    pilot, boot_ms = talking.autopilot, (talking.now_ns - talking.boot_offset_ns) // 1_000_000
    assert pilot.origin is not None
    north, east, down = autopilot_ned_from_geo(PX4, PLACE, pilot.origin)
    pilot.send(mav.MAVLink_local_position_ned_message(boot_ms, north, east, down, 0.0, 0.0, 0.0))
    where = round(PLACE.lat_deg * 1e7), round(PLACE.lon_deg * 1e7), round(PLACE.h_amsl_m * 1e3)
    pilot.send(mav.MAVLink_global_position_int_message(boot_ms, *where, 50_000, 0, 0, 0, 0))


def flying() -> Conversation:
    """A PX4 that has told its origin, and where it is; it is asked for the origin again only seconds later."""
    talking = talk(kind=PX4)
    talking.run(3.0)
    say_where(talking)
    talking.run(0.02)
    assert talking.session.send(injection(talking.now_ns), talking.now_ns)
    return talking


def test_an_origin_that_moved_unheard_is_asked_for_at_once_and_nothing_is_sent_about_the_old_one() -> None:
    talking = flying()
    talking.autopilot.origin = MOVED
    say_where(talking)
    talking.autopilot.behaviour.mute_commands = True
    talking.run(0.02)
    talking.run(0.1)
    assert not talking.session.send(injection(talking.now_ns), talking.now_ns)
    assert talking.session.refused == {Reason.NO_ORIGIN: 1}
    assert talking.session.origin == ORIGIN
    talking.autopilot.behaviour.mute_commands = False
    talking.run(1.2)  # the next question
    assert talking.session.origin is not None
    assert talking.session.origin.lat_deg == pytest.approx(MOVED.lat_deg, abs=1e-6)
    about_new = replace(injection(talking.now_ns), place=geo_from_autopilot_ned(PX4, (10.0, -3.0, -42.0), talking.session.origin))
    assert talking.session.send(about_new, talking.now_ns)


def test_a_question_whose_answer_is_outstanding_does_not_keep_the_new_origin_away() -> None:
    talking = flying()
    talking.autopilot.behaviour.mute_commands = True
    talking.run(5.2, until=lambda: talking.session._upkeep._queue.busy_with("origin"))
    talking.autopilot.behaviour.mute_commands = False
    talking.autopilot.origin = MOVED
    say_where(talking)
    events = talking.run(0.1)
    assert any(isinstance(event, OriginChanged) for event in events)


def test_positions_that_do_not_fit_the_origin_that_is_told_upon_it_stop_nothing() -> None:
    talking = flying()
    talking.autopilot.origin = MOVED
    say_where(talking)
    talking.autopilot.origin = ORIGIN  # which it tells, as before
    talking.run(0.2)
    for _ in range(3):
        talking.autopilot.origin = MOVED
        say_where(talking)
        talking.autopilot.origin = ORIGIN
        talking.run(0.02)
        assert talking.session.send(injection(talking.now_ns), talking.now_ns)


def test_a_jump_between_two_samples_is_no_other_origin() -> None:
    check = OriginCheck()
    place, still = geo_from_autopilot_ned(PX4, (30.0, 0.0, 0.0), ORIGIN), (0.0, 0.0, 0.0)
    assert not check.hear(LocalPose(0, 0, (0.0, 0.0, 0.0), still), PX4, ORIGIN)
    assert check.hear(PriorPose(0, 20_000_000, place, still, 0.0), PX4, ORIGIN)
    assert not check.hear(LocalPose(0, 100_000_000, (30.0, 0.0, 0.0), still), PX4, ORIGIN)
    assert not check.doubted


def test_samples_of_different_times_and_a_vehicle_in_motion_say_nothing_of_the_origin() -> None:
    check = OriginCheck()
    place, fast = geo_from_autopilot_ned(PX4, (12.0, 0.0, 0.0), ORIGIN), (100.0, 0.0, 0.0)
    check.hear(LocalPose(0, 0, (0.0, 0.0, 0.0), fast), PX4, ORIGIN)
    assert not check.hear(PriorPose(0, 120_000_000, place, fast, 0.0), PX4, ORIGIN)
    assert not check.hear(PriorPose(0, 900_000_000, MOVED, fast, 0.0), PX4, ORIGIN)
    assert not check.hear(PriorPose(0, 10_000_000, MOVED, fast, 0.0), AutopilotKind.UNKNOWN, ORIGIN)
    assert not check.hear(PriorPose(0, 10_000_000, MOVED, fast, 0.0), PX4, None)
