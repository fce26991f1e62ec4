"""A picture that does not tilt with the vehicle is told, and that it does so again; one that comes late, or is calm, is not."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera.level_watch import LevelWatch
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.geo import se3
from visloc_companion.types import Notice, Quat, Turn

S = 1_000_000_000
COV = ((1e-6, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 1e-6))
LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
UNUSED, AGAIN = "visloc: picture keeps level: EIS, gimbal? unused", "visloc: picture tilts with the vehicle again"


def swinging(t_s: float) -> Quat:
    return se3.quat_from_euler(0.03 * math.sin(1.9 * t_s), 0.025 * math.cos(1.3 * t_s), 0.2 * t_s)


def calm(t_s: float) -> Quat:
    return se3.quat_from_euler(0.003 * math.sin(1.9 * t_s), 0.003 * math.cos(1.3 * t_s), 0.2 * t_s)


def kept_level(q: Quat) -> Quat:
    return se3.quat_from_euler(0.0, 0.0, se3.euler_from_quat(q)[2])


def said(
    stabilised: Callable[[float], bool],
    attitude_at: Callable[[float], Quat] = swinging,
    late_s: float = 0.0,
    recognised: bool = False,
    right_until_s: list[float] | None = None,
) -> list[tuple[float, str]]:
    """Two frames a second for a minute, with when it was said; `right_until_s` is given the watch's word in the end."""
    clock, attitude, rng = ClockOffset(), AttitudeBuffer(), np.random.default_rng(1)
    watch, told = LevelWatch(clock, attitude), []
    for k in range(1, 60 * 30):
        t_ns = k * S // 30
        clock.on_arrival(t_ns, t_ns)
        attitude.add(t_ns, attitude_at(k / 30), (0.0, 0.0, 0.0))
        if k % 15 or k < 60:
            continue
        first_ns, last_ns = t_ns - 2 * S // 3, t_ns - S // 6
        before, now = (attitude_at(at * 1e-9 - late_s) for at in (first_ns, last_ns))
        if stabilised(last_ns * 1e-9):
            before, now = kept_level(before), kept_level(now)
        noise = se3.quat_from_vector(tuple(rng.normal(0.0, math.radians(0.07), 3).tolist()))
        seen = se3.quat_multiply(se3.quat_multiply(se3.quat_inverse(before), now), noise)
        if recognised:
            watch.recognised()
        notices = watch.on_turn(Turn(first_ns, last_ns, seen, COV), LEVEL)
        told += [(last_ns * 1e-9, notice.text) for notice in notices if isinstance(notice, Notice)]
    if right_until_s is not None:
        right_until_s.append(watch.right_until_ns * 1e-9)
    return told


def test_stabilisation_that_is_switched_on_is_told_within_seconds_and_its_end_too() -> None:
    right_until_s: list[float] = []
    (on_s, on), (off_s, off) = said(lambda t: 20 < t < 40, right_until_s=right_until_s)
    assert (on, off) == (UNUSED, AGAIN)
    assert 8 < right_until_s[0] < 12
    assert 20 < on_s < 26
    assert 40 < off_s < 46


@pytest.mark.parametrize("late_s", [0.0, 0.3, 1.0, 2.5])
def test_a_picture_that_swings_is_not_told_however_late_it_comes(late_s: float) -> None:
    assert said(lambda t: False, late_s=late_s) == []


def test_a_vehicle_that_does_not_swing_shows_nothing() -> None:
    assert said(lambda t: True, attitude_at=calm) == []


def test_pictures_that_are_recognised_are_used() -> None:
    assert said(lambda t: True, recognised=True) == []


def test_turns_of_times_that_the_autopilots_clock_does_not_know_are_not_judged() -> None:
    watch, turned = LevelWatch(ClockOffset(), AttitudeBuffer()), se3.quat_from_euler(0.1, 0.0, 0.0)
    for k in range(100):
        assert watch.on_turn(Turn(k * S, (k + 1) * S, turned, COV), LEVEL) == []
    assert not watch.wrong
