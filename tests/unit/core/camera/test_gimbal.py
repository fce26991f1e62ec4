"""Where a gimbal points: what its attitude counts from, whose clock it is stamped with, and which frames it makes useless."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera.gimbal import Gimbal
from visloc_companion.core.settings import GimbalSettings
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.errors import Reason
from visloc_companion.geo import se3
from visloc_companion.types import GimbalAttitude, GimbalFrame, Quat, Vec3

MS = 1_000_000
OFFSET_NS = 40_000 * MS
"""Our clock less the autopilot's."""
LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
DOWN: Vec3 = (0.0, 0.0, 1.0)
FORWARD: Vec3 = (1.0, 0.0, 0.0)
NADIR = se3.quat_from_euler(0.0, -math.pi / 2, 0.0)


def rpy(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Quat:
    return se3.quat_from_euler(math.radians(roll_deg), math.radians(pitch_deg), math.radians(yaw_deg))


def said(t_ms: int, q: Quat, frame: GimbalFrame = GimbalFrame.HEADING, gimbal_id: int = 1) -> GimbalAttitude:
    """By the autopilot, 5 ms under way."""
    return GimbalAttitude(t_ms * MS + OFFSET_NS + 5 * MS, t_ms * MS, gimbal_id, q, frame)


def told(t_ms: int, q: Quat, own_ms: int) -> GimbalAttitude:
    """By the gimbal's own component, stamped with its own clock."""
    event = said(t_ms, q, gimbal_id=154)
    return replace(event, t_boot_ns=0, t_own_ns=own_ms * MS)


class Bench:
    """A gimbal beneath a vehicle whose attitude is said every 20 ms for two seconds."""

    def __init__(self, vehicle: Quat = LEVEL, yaw_rate_degps: float = 0.0, **settings: object) -> None:
        self.clock, self.attitude = ClockOffset(), AttitudeBuffer()
        self.gimbal = Gimbal(GimbalSettings(**settings), self.clock, self.attitude)  # type: ignore[arg-type]
        for t_ms in range(0, 2001, 20):
            self.clock.on_arrival(t_ms * MS + OFFSET_NS, t_ms * MS)
            turned = se3.quat_multiply(rpy(0.0, 0.0, yaw_rate_degps * t_ms / 1000), vehicle)
            self.attitude.add(t_ms * MS, turned, (0.0, 0.0, math.radians(yaw_rate_degps)))

    def hold(self, q: Quat, frame: GimbalFrame = GimbalFrame.HEADING, every_ms: int = 40) -> Bench:
        for t_ms in range(0, 2001, every_ms):
            assert self.gimbal.on_attitude(said(t_ms, q, frame))
        return self

    def body_at(self, t_ms: int) -> Quat:
        q = self.gimbal.at(t_ms * MS)
        assert q is not None
        return q


def off_deg(a: Quat, b: Quat) -> float:
    return math.degrees(se3.angle_between(a, b))


def test_straight_down_is_a_level_body_with_the_upper_side_forward() -> None:
    """Pitch -90 is down (ArduCopter's simulator: MAV_CMD_DO_MOUNT_CONTROL with -90 is stated so), and yaw that of the vehicle."""
    body = Bench(rpy(0.0, 0.0, 70.0)).hold(NADIR).body_at(1000)
    assert off_deg(body, rpy(0.0, 0.0, 70.0)) < 1e-6


def test_a_gimbal_above_straight_down_looks_ahead() -> None:
    body = Bench(rpy(0.0, 0.0, 90.0)).hold(rpy(0.0, -60.0, 0.0)).body_at(1000)
    north, east, down = se3.rotate(body, DOWN)
    assert (north, east, down) == pytest.approx((0.0, 0.5, math.sqrt(0.75)), abs=1e-9), "30 degrees ahead, to the east"


@pytest.mark.parametrize(
    ("frame", "heading_deg", "leans"),
    [(GimbalFrame.HEADING, 90.0, False), (GimbalFrame.NORTH, 20.0, False), (GimbalFrame.AIRFRAME, 90.0, True)],
)
def test_what_it_counts_from(frame: GimbalFrame, heading_deg: float, leans: bool) -> None:
    """A vehicle that heads for 70 degrees and leans by 25; the gimbal states straight down and a yaw of 20."""
    vehicle = rpy(25.0, -15.0, 70.0)
    body = Bench(vehicle).hold(rpy(0.0, -90.0, 20.0), frame).body_at(1000)
    lean = se3.quat_multiply(vehicle, rpy(0.0, 0.0, 20.0)) if leans else rpy(0.0, 0.0, heading_deg)
    assert off_deg(body, lean) < 1e-6


def test_servos_as_arducopter_states_them() -> None:
    """MNT1_TYPE 1, 4.7-dev in its own simulator: told to look straight down, braking with -29.0 degrees of pitch, it states
    (-0.0886, -1.0647, -0.0005) about the airframe, with flags that name the horizon. That is straight down up to the roll,
    which an angle of the third axis does not undo."""
    vehicle, stated = rpy(7.7, -29.1, -2.3), (0.8598, -0.0586, -0.5061, -0.0345)
    as_flagged = Bench(vehicle).hold(se3.normalised(stated)).body_at(1000)
    as_it_is = Bench(vehicle, frame=GimbalFrame.AIRFRAME).hold(se3.normalised(stated)).body_at(1000)
    tilt_deg = [math.degrees(math.acos(se3.rotate(body, DOWN)[2])) for body in (as_flagged, as_it_is)]
    assert tilt_deg[0] == pytest.approx(29.0, abs=0.5), "as its flags say it would look 29 degrees ahead"
    assert tilt_deg[1] < 7.0


def test_the_configured_frame_goes_before_the_stated_one() -> None:
    body = Bench(rpy(0.0, 0.0, 70.0), frame=GimbalFrame.NORTH).hold(NADIR, GimbalFrame.HEADING).body_at(1000)
    assert off_deg(body, LEVEL) < 1e-6


def test_its_yaw_turns_with_the_vehicle_between_two_words_of_it() -> None:
    """At 5 Hz, while the vehicle yaws with 60 degrees/s: the heading is that of the frame's time."""
    bench = Bench(yaw_rate_degps=60.0).hold(NADIR, every_ms=200)
    for t_ms in (1000, 1070, 1150):
        assert off_deg(bench.body_at(t_ms), rpy(0.0, 0.0, 0.06 * t_ms)) < 0.01
    assert bench.gimbal.rate_radps(1070 * MS, 30 * MS) == pytest.approx((0.0, 0.0, math.radians(60.0)), abs=1e-3)


def test_beyond_its_last_word_nothing_is_known() -> None:
    bench = Bench()
    assert bench.gimbal.at(1000 * MS) is None
    assert bench.gimbal.refusal(1000 * MS, LEVEL) is Reason.NO_GIMBAL_ATTITUDE
    for t_ms in range(0, 1001, 40):
        bench.gimbal.on_attitude(said(t_ms, NADIR))
    assert bench.gimbal.refusal(1090 * MS, LEVEL) is None
    assert bench.gimbal.refusal(1110 * MS, LEVEL) is Reason.NO_GIMBAL_ATTITUDE
    bench.gimbal.clear()
    assert bench.gimbal.at(1000 * MS) is None


@pytest.mark.parametrize(("degps", "reason"), [(10.0, None), (20.0, Reason.GIMBAL_TURNING)])
def test_frames_of_a_gimbal_that_turns_fast_are_not_used(degps: float, reason: Reason | None) -> None:
    bench = Bench()
    for t_ms in range(0, 2001, 40):
        bench.gimbal.on_attitude(said(t_ms, rpy(0.0, -90.0 + degps * t_ms / 1000, 0.0)))
    assert bench.gimbal.refusal(1000 * MS, LEVEL) is reason


def test_a_vehicle_that_yaws_beneath_the_camera_is_no_turn_of_the_gimbal() -> None:
    assert Bench(yaw_rate_degps=90.0).hold(NADIR).gimbal.refusal(1000 * MS, LEVEL) is None


@pytest.mark.parametrize(
    ("pitch_deg", "reason"), [(-90.0, None), (-46.0, None), (-44.0, Reason.HORIZON_IN_VIEW), (0.0, Reason.HORIZON_IN_VIEW)]
)
def test_beyond_45_degrees_from_straight_down_frames_are_not_used(pitch_deg: float, reason: Reason | None) -> None:
    assert Bench().hold(rpy(0.0, pitch_deg, 0.0)).gimbal.refusal(1000 * MS, LEVEL) is reason


def test_it_is_the_camera_that_must_look_down() -> None:
    """A camera that is mounted 60 degrees above where its gimbal points."""
    assert Bench().hold(NADIR).gimbal.refusal(1000 * MS, rpy(0.0, 60.0, 0.0)) is Reason.HORIZON_IN_VIEW


def test_one_that_has_failed_says_nothing() -> None:
    bench = Bench()
    assert not bench.gimbal.on_attitude(replace(said(0, NADIR), failed=True))
    assert bench.gimbal.at(0) is None
    assert bench.gimbal.on_attitude(said(0, NADIR))


def test_of_several_gimbals_one_is_listened_to() -> None:
    first, second = Bench(), Bench(gimbal_id=2)
    for t_ms in range(0, 2001, 40):
        for bench in (first, second):
            bench.gimbal.on_attitude(said(t_ms, NADIR))
            bench.gimbal.on_attitude(said(t_ms, rpy(0.0, -60.0, 0.0), gimbal_id=2))
    assert se3.rotate(first.body_at(1000), DOWN)[2] == pytest.approx(1.0)
    assert se3.rotate(second.body_at(1000), DOWN)[0] == pytest.approx(0.5)


def test_the_autopilots_word_goes_before_that_of_the_gimbal_itself() -> None:
    """It comes as often as it was asked for."""
    bench = Bench()
    assert bench.gimbal.on_attitude(told(0, rpy(0.0, -60.0, 0.0), 7))
    for t_ms in range(0, 2001, 40):
        assert bench.gimbal.on_attitude(said(t_ms, NADIR))
        assert not bench.gimbal.on_attitude(told(t_ms, rpy(0.0, -60.0, 0.0), t_ms + 7))
    assert se3.rotate(bench.body_at(1000), DOWN)[2] == pytest.approx(1.0)


@pytest.mark.parametrize("of_autopilot", [False, True], ids=["gimbal", "passed on"])
def test_its_own_clock_is_compared_by_arrivals(of_autopilot: bool) -> None:
    """It booted an hour before, and is 5 to 45 ms under way. An autopilot that passes its stamps on states the same."""
    bench = Bench()
    for t_ms in range(0, 2001, 40):
        event = told(t_ms, rpy(0.0, -90.0 + 10.0 * t_ms / 1000, 0.0), 3_600_000 + t_ms)
        event = replace(event, t_rx_ns=event.t_rx_ns + (40 * MS if t_ms % 3 else 0))
        if of_autopilot:
            event = replace(event, gimbal_id=1, t_boot_ns=event.t_own_ns or 0, t_own_ns=None)
        assert bench.gimbal.on_attitude(event)
    north, _, down = se3.rotate(bench.body_at(1500), DOWN)
    assert math.degrees(math.atan2(north, down)) == pytest.approx(15.0, abs=0.06), "5 ms late: 0.05 degrees"


def test_without_any_stamp_it_counts_from_its_arrival() -> None:
    bench = Bench()
    for t_ms in range(0, 2001, 40):
        assert bench.gimbal.on_attitude(told(t_ms, rpy(0.0, -90.0 + 10.0 * t_ms / 1000, 0.0), 0))
    north, _, down = se3.rotate(bench.body_at(1500), DOWN)
    assert math.degrees(math.atan2(north, down)) == pytest.approx(15.0, abs=0.06)


def test_another_frame_begins_anew() -> None:
    """Between a yaw against the vehicle and one against north nothing is interpolated."""
    bench = Bench(rpy(0.0, 0.0, 90.0))
    for t_ms in range(0, 1001, 40):
        bench.gimbal.on_attitude(said(t_ms, NADIR))
    for t_ms in range(1040, 2001, 40):
        bench.gimbal.on_attitude(said(t_ms, rpy(0.0, -90.0, 90.0), GimbalFrame.NORTH))
    assert off_deg(bench.body_at(1500), rpy(0.0, 0.0, 90.0)) < 1e-6
    assert bench.gimbal.at(900 * MS) is None


def test_before_the_autopilots_clock_is_known_a_gimbal_says_nothing() -> None:
    gimbal = Gimbal(GimbalSettings(), ClockOffset(), AttitudeBuffer())
    assert not gimbal.on_attitude(told(0, NADIR, 7))
    assert gimbal.at(0) is None


def test_what_is_said_twice_counts_once() -> None:
    bench = Bench()
    assert bench.gimbal.on_attitude(said(40, NADIR))
    assert not bench.gimbal.on_attitude(said(40, rpy(0.0, -60.0, 0.0)))
    assert not bench.gimbal.on_attitude(said(0, rpy(0.0, -60.0, 0.0)))
    assert se3.rotate(bench.body_at(40), DOWN)[2] == pytest.approx(1.0)


def test_a_gimbal_that_boots_again_goes_on() -> None:
    """Its clock falls back; what it said by the old one is forgotten."""
    bench = Bench()
    for t_ms in range(0, 1001, 40):
        assert bench.gimbal.on_attitude(told(t_ms, NADIR, 3_600_000 + t_ms))
    for t_ms in range(1040, 2001, 40):
        assert bench.gimbal.on_attitude(told(t_ms, rpy(0.0, -60.0, 0.0), t_ms - 1000))
    assert bench.gimbal.at(900 * MS) is None
    assert se3.rotate(bench.body_at(1500), DOWN)[0] == pytest.approx(0.5)
