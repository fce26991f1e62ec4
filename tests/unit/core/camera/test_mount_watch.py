"""A camera that is mounted otherwise than configured is told by the axes that its picture turns about."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import numpy as np
import pytest

from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera.mount_watch import MountWatch
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.geo import se3
from visloc_companion.types import Notice, Quat, Turn

S = 1_000_000_000
COV = ((1e-6, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 1e-6))
LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
NOISE_RAD = math.radians(0.07)
"""Of a seen turn, each axis: rendered frames of 640 x 480, three a second."""


def mounted(roll_deg: float = 0.0, pitch_deg: float = 0.0, yaw_deg: float = 0.0) -> Quat:
    return se3.quat_from_euler(*map(math.radians, (roll_deg, pitch_deg, yaw_deg)))


def copter_at(t_s: float) -> Quat:
    """Leans by some degrees, and turns into another leg now and then."""
    heading = 0.8 * math.floor(t_s / 12) + 0.8 * min(1.0, (t_s % 12) / 3)
    return se3.quat_from_euler(0.04 * math.sin(1.3 * t_s), 0.035 * math.cos(1.7 * t_s), heading)


def circling_at(t_s: float) -> Quat:
    """The lean goes round once in 3 s: half a second later it is one of a vehicle that is turned by 60 degrees."""
    phase = 2 * math.pi * t_s / 3
    return se3.quat_from_euler(0.05 * math.cos(phase), 0.05 * math.sin(phase), 0.0)


def banked_at(t_s: float) -> Quat:
    """A plane: banks by 40 degrees, and turns meanwhile."""
    bank = math.radians(40) * math.sin(0.4 * t_s)
    return se3.quat_from_euler(bank, 0.05 + 0.02 * math.sin(t_s), 0.6 * (1 - math.cos(0.4 * t_s)))


def calm_at(t_s: float) -> Quat:
    """Turns about, and leans by next to nothing."""
    return se3.quat_from_euler(0.001 * math.sin(t_s), 0.001 * math.cos(1.3 * t_s), 0.2 * t_s)


def said(
    real: Quat,
    configured: Quat = LEVEL,
    attitude_at: Callable[[float], Quat] = copter_at,
    late_s: float = 0.0,
    seconds: int = 60,
    wrong_each: int = 0,
    recognised_each: int = 0,
) -> list[Notice]:
    """What is told of pictures by a camera that is mounted as `real`, in frames each 333 ms whose stamps are so late; each
    so many turns one is followed wrong, or a place is found."""
    clock, attitude, rng = ClockOffset(), AttitudeBuffer(), np.random.default_rng(1)
    watch, told = MountWatch(clock, attitude, configured), []
    for k in range(1, 30 * seconds):
        t_ns = k * S // 30
        clock.on_arrival(t_ns, t_ns)
        attitude.add(t_ns, attitude_at(k / 30), (0.0, 0.0, 0.0))
        if k % 10 or k < 40:
            continue
        a, b = (se3.quat_multiply(attitude_at(at - late_s), real) for at in ((k - 10) / 30, k / 30))
        seen = np.array(se3.vector_from_quat(se3.quat_multiply(se3.quat_inverse(a), b))) + rng.normal(0.0, NOISE_RAD, 3)
        if wrong_each and k // 10 % wrong_each == 0:
            seen = rng.normal(0.0, 0.05, 3)
        if recognised_each and k // 10 % recognised_each == 0:
            watch.recognised()
        told += watch.on_turn(Turn((k - 10) * S // 30, t_ns, se3.quat_from_vector(tuple(seen.tolist())), COV))
    assert watch.wrong == bool(told)
    return [notice for notice in told if isinstance(notice, Notice)]


@pytest.mark.parametrize(
    ("real", "configured", "text"),
    [
        (mounted(yaw_deg=90), LEVEL, "visloc: camera turned, try mount_yaw_deg = 90"),
        (mounted(yaw_deg=180), LEVEL, "visloc: camera turned, try mount_yaw_deg = 180"),
        (mounted(yaw_deg=270), LEVEL, "visloc: camera turned, try mount_yaw_deg = -90"),
        (LEVEL, mounted(yaw_deg=90), "visloc: camera turned, try mount_yaw_deg = 0"),
        (mounted(yaw_deg=20), LEVEL, "visloc: camera turned, try mount_yaw_deg = 20"),
        (mounted(pitch_deg=30), LEVEL, "visloc: camera tilted, try mount_pitch_deg = 30"),
        (LEVEL, mounted(pitch_deg=30), "visloc: camera tilted, try mount_pitch_deg = 0"),
        (mounted(roll_deg=-25), LEVEL, "visloc: camera tilted, try mount_roll_deg = -25"),
        (mounted(0, 30, 180), LEVEL, "visloc: try mount roll 0 pitch 30 yaw 180 deg"),
    ],
    ids=["right", "back", "left", "config right", "a little", "ahead", "config ahead", "sideways", "ahead, back"],
)
@pytest.mark.parametrize("late_s", [0.0, 0.15])
def test_another_mounting_is_told_once_with_what_to_write(real: Quat, configured: Quat, text: str, late_s: float) -> None:
    (notice,) = said(real, configured, late_s=late_s, seconds=120)
    assert re.sub(r"-?\d+", "N", notice.text) == re.sub(r"-?\d+", "N", text)
    for found_deg, right_deg in zip(re.findall(r"-?\d+", notice.text), re.findall(r"-?\d+", text), strict=True):
        assert abs((float(found_deg) - float(right_deg) + 180) % 360 - 180) <= 3
    found = mounted(*(float(dict(notice.data)[name]) for name in ("roll", "pitch", "yaw")))
    assert math.degrees(se3.angle_between(found, real)) < 3.0
    assert notice.to_operator
    assert len(notice.text) <= 50


def test_turns_that_are_followed_wrong_do_not_hide_it() -> None:
    (notice,) = said(mounted(yaw_deg=90), wrong_each=8)
    assert notice.text == "visloc: camera turned, try mount_yaw_deg = 90"


@pytest.mark.parametrize("attitude_at", [copter_at, circling_at, banked_at, calm_at])
@pytest.mark.parametrize("late_s", [0.0, 0.12, 0.45])
@pytest.mark.parametrize("real", [LEVEL, mounted(3, -4, 5)], ids=["right", "some degrees off"])
def test_a_mounting_as_configured_is_not_told(attitude_at: Callable[[float], Quat], late_s: float, real: Quat) -> None:
    assert said(real, attitude_at=attitude_at, late_s=late_s, wrong_each=7) == []


def test_who_turns_about_one_axis_only_shows_no_mounting() -> None:
    assert said(mounted(yaw_deg=90), attitude_at=calm_at, seconds=90) == []


def test_a_mirrored_picture_is_left_to_others() -> None:
    upside_down = mounted(roll_deg=180)
    assert said(upside_down) == []


def test_a_camera_whose_pictures_are_recognised_is_not_judged_but_by_a_few() -> None:
    assert said(mounted(yaw_deg=90), recognised_each=2) == []
    assert said(mounted(yaw_deg=90), recognised_each=12) != []


def test_turns_of_times_without_attitude_say_nothing() -> None:
    watch = MountWatch(ClockOffset(), AttitudeBuffer(), LEVEL)
    assert watch.on_turn(Turn(0, S, se3.quat_from_vector((0.1, 0.0, 0.0)), COV)) == []
