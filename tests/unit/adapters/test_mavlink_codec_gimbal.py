"""GIMBAL_DEVICE_ATTITUDE_STATUS to events: frames by flags, whose gimbal, whose clock, what is worth nothing."""

from __future__ import annotations

import math
from typing import Any

import pytest

from tests.unit.adapters.session_talk import talk
from visloc_companion.adapters.mavlink.codec import decode, examine
from visloc_companion.adapters.mavlink.codec_gimbal import frame_of
from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.errors import Reason
from visloc_companion.geo.se3 import euler_from_quat
from visloc_companion.types import Attitude, GimbalAttitude, GimbalFrame

NAN, T = math.nan, 5_000_000_000
LOCKED = mav.GIMBAL_DEVICE_FLAGS_ROLL_LOCK | mav.GIMBAL_DEVICE_FLAGS_PITCH_LOCK
VEHICLE, EARTH = mav.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME, mav.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME
YAW_LOCK = mav.GIMBAL_DEVICE_FLAGS_YAW_LOCK
AHEAD = (0.9239, 0.0, -0.3827, 0.0)
"""ArduCopter 4.7-dev in its own simulator after MAV_CMD_DO_MOUNT_CONTROL with -45 degrees of pitch, MNT1_TYPE 7."""


def status(
    q: tuple[float, ...] = AHEAD, flags: int = LOCKED | VEHICLE, failure: int = 0, number: int = 1, delta_yaw: float = NAN
) -> Any:
    return mav.MAVLink_gimbal_device_attitude_status_message(
        0, 0, 81_234, flags, q, NAN, NAN, NAN, failure, delta_yaw, delta_yaw, number
    )


def over_the_wire(message: Any, component: int = 1, system: int = 1) -> Any:
    sender = mav.MAVLink(None, srcSystem=system, srcComponent=component)
    (received,) = mav.MAVLink(None).parse_buffer(message.pack(sender))
    return received


def one(message: Any) -> GimbalAttitude:
    (event,) = decode(message, T)
    assert isinstance(event, GimbalAttitude)
    return event


@pytest.mark.parametrize("delta_yaw", [NAN, 0.0], ids=["ardupilot", "px4"])
def test_as_the_autopilots_send_it(delta_yaw: float) -> None:
    """What they put into delta_yaw is not the heading: ArduPilot sends NaN, PX4 zero whatever way the vehicle looks."""
    event = one(over_the_wire(status(delta_yaw=delta_yaw)))
    roll, pitch, yaw = euler_from_quat(event.q_frame_gimbal)
    assert (roll, math.degrees(pitch), yaw) == pytest.approx((0.0, -45.0, 0.0), abs=0.01)
    assert event.frame is GimbalFrame.HEADING
    assert (event.t_rx_ns, event.t_boot_ns, event.t_own_ns, event.gimbal_id, event.failed) == (T, 81_234_000_000, None, 1, False)


@pytest.mark.parametrize(
    ("flags", "frame"),
    [
        (LOCKED | VEHICLE, GimbalFrame.HEADING),
        (
            LOCKED | VEHICLE | YAW_LOCK,
            GimbalFrame.HEADING,
        ),  # ArduCopter's simulator: locked to 20 degrees, heading 0.5, stated 19.5
        (LOCKED | EARTH, GimbalFrame.NORTH),
        (LOCKED | EARTH | YAW_LOCK, GimbalFrame.NORTH),
        (LOCKED, GimbalFrame.HEADING),  # ArduPilot until 4.4
        (LOCKED | YAW_LOCK, GimbalFrame.NORTH),  # PX4 with a locked yaw, gimbals of before 2023
        (0, GimbalFrame.HEADING),
        (VEHICLE | EARTH, None),
    ],
)
def test_what_the_flags_say_of_its_frame(flags: int, frame: GimbalFrame | None) -> None:
    assert frame_of(flags) is frame
    if frame is None:
        assert examine(over_the_wire(status(flags=flags)), T) is Reason.BAD_INPUT
    else:
        assert one(over_the_wire(status(flags=flags))).frame is frame


def test_a_gimbal_that_speaks_itself_has_a_clock_of_its_own() -> None:
    event = one(over_the_wire(status(number=0), component=154))
    assert (event.gimbal_id, event.t_boot_ns, event.t_own_ns) == (154, 0, 81_234_000_000)


def test_an_autopilot_that_numbers_none_means_its_first() -> None:
    assert one(over_the_wire(status(number=0))).gimbal_id == 1
    assert one(over_the_wire(status(number=2))).gimbal_id == 2


@pytest.mark.parametrize(
    ("failure", "failed"),
    [
        (mav.GIMBAL_DEVICE_ERROR_FLAGS_AT_PITCH_LIMIT, False),
        (mav.GIMBAL_DEVICE_ERROR_FLAGS_MOTOR_ERROR, False),
        (mav.GIMBAL_DEVICE_ERROR_FLAGS_ENCODER_ERROR, True),
        (mav.GIMBAL_DEVICE_ERROR_FLAGS_COMMS_ERROR | mav.GIMBAL_DEVICE_ERROR_FLAGS_AT_PITCH_LIMIT, True),
        (mav.GIMBAL_DEVICE_ERROR_FLAGS_CALIBRATION_RUNNING, True),
    ],
)
def test_failures_of_which_its_attitude_suffers(failure: int, failed: bool) -> None:
    assert one(over_the_wire(status(failure=failure))).failed is failed


@pytest.mark.parametrize(
    ("q", "reason"),
    [
        ((NAN, 0.0, 0.0, 0.0), Reason.NOT_FINITE),
        ((0.0, 0.0, 0.0, 0.0), Reason.BAD_INPUT),
        ((2.0, 0.0, 0.0, 0.0), Reason.BAD_INPUT),
    ],
)
def test_what_is_no_attitude(q: tuple[float, ...], reason: Reason) -> None:
    assert examine(over_the_wire(status(q=q)), T) is reason


# ------------------------------------------------------------------------------------------------------------ on the link


def packed(message: Any, component: int, system: int = 1) -> bytes:
    return bytes(message.pack(mav.MAVLink(None, srcSystem=system, srcComponent=component)))


def heard(session: MavlinkSession, component: int, system: int = 1, now_ns: int = T) -> list[GimbalAttitude]:
    events = session.receive(packed(status(), component, system), now_ns)
    return [event for event in events if isinstance(event, GimbalAttitude)]


def test_gimbals_of_the_vehicle_are_heard_and_nobody_elses() -> None:
    conversation = talk()
    conversation.run(2.0)
    session, now_ns = conversation.session, conversation.now_ns
    assert [event.gimbal_id for event in heard(session, 1, now_ns=now_ns)] == [1]
    assert [event.gimbal_id for event in heard(session, 154, now_ns=now_ns)] == [154]
    assert [event.gimbal_id for event in heard(session, 173, now_ns=now_ns)] == [173]
    assert heard(session, 191, now_ns=now_ns) == [], "another companion"
    assert heard(session, 154, system=7, now_ns=now_ns) == [], "another vehicle's"


def test_a_gimbal_that_goes_on_is_no_sign_that_the_autopilot_lives() -> None:
    conversation = talk()
    conversation.run(2.0)
    session, now_ns = conversation.session, conversation.now_ns
    assert session.link.up
    before = session.n_heard
    for k in range(1, 120):
        session.receive(packed(status(), 154), now_ns + k * 50_000_000)
        session.poll(now_ns + k * 50_000_000)
    assert not session.link.up
    assert session.n_heard == before
    assert heard(session, 154, now_ns=now_ns + 6_000_000_000) == [], "nor does anybody listen to it then"


def test_of_another_component_only_the_gimbals_attitude_is_taken() -> None:
    conversation = talk()
    conversation.run(2.0)
    attitude = mav.MAVLink_attitude_message(1234, 0.1, -0.2, 3.0, 0.0, 0.0, 0.0)
    events = conversation.session.receive(packed(attitude, 154), conversation.now_ns)
    assert not [event for event in events if isinstance(event, Attitude)]
