"""A mirrored picture is told by how it turns."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera.mirror_watch import FEWEST, MirrorWatch
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.geo import se3
from visloc_companion.types import Notice, Quat, Turn

S = 1_000_000_000
COV = ((1e-6, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 1e-6))
LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
AS_IT_IS, LEFT_FOR_RIGHT, TOP_FOR_BOTTOM, TURNED_ROUND = (1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)
"""What becomes of a turn's vector (forward, right, down); of a picture whose axes swap sides the turn is an axial vector. The
first swaps the axis to the right, the second the one ahead."""


def attitude_at(t_s: float) -> Quat:
    """Turns of up to 20°/s either way, and leans."""
    return se3.quat_from_euler(0.1 * math.sin(1.3 * t_s), 0.08 * math.cos(1.7 * t_s), 0.7 * math.sin(0.5 * t_s))


def wobbling_at(t_s: float) -> Quat:
    """The heading swings by 3° each way, once a second: half a second later it turns the other way."""
    return se3.quat_from_euler(0.0, 0.0, 0.05 * math.sin(2 * math.pi * t_s))


def said(
    swapped: tuple[int, int, int],
    mount: Quat = LEVEL,
    seconds: int = 40,
    late_s: float = 0.0,
    attitude_at: Callable[[float], Quat] = attitude_at,
) -> list[Notice]:
    """What is told of a picture whose turns are swapped so, in frames each 250 ms that bear a time so late."""
    clock, attitude = ClockOffset(), AttitudeBuffer()
    watch, told = MirrorWatch(clock, attitude), []
    for k in range(1, 20 * seconds):
        t_ns = k * S // 20
        clock.on_arrival(t_ns, t_ns)
        attitude.add(t_ns, attitude_at(k / 20), (0.0, 0.0, 0.0))
        if k % 5 or k < 10:
            continue
        a, b = (se3.quat_multiply(attitude_at(at - late_s), mount) for at in (k / 20 - 0.25, k / 20))
        seen = np.array(se3.vector_from_quat(se3.quat_multiply(se3.quat_inverse(a), b))) * swapped
        told += watch.on_turn(Turn(t_ns - S // 4, t_ns, se3.quat_from_vector(tuple(seen.tolist())), COV), mount)
    assert watch.mirrored == bool(told)
    return [notice for notice in told if isinstance(notice, Notice)]


@pytest.mark.parametrize("mount_deg", [0.0, 90.0, 180.0])
@pytest.mark.parametrize("swapped", [LEFT_FOR_RIGHT, TOP_FOR_BOTTOM])
@pytest.mark.parametrize("late_s", [0.0, 0.3])
def test_a_mirrored_picture_is_told_once(swapped: tuple[int, int, int], mount_deg: float, late_s: float) -> None:
    (notice,) = said(swapped, se3.quat_from_euler(0.0, 0.1, math.radians(mount_deg)), late_s=late_s)
    assert notice.text == "visloc: picture is mirrored, NOT USED"
    assert notice.to_operator
    assert dict(notice.data)["seen_of_reported"] < -0.7


@pytest.mark.parametrize("late_s", [0.0, 0.3, 0.5])
@pytest.mark.parametrize("swapped", [AS_IT_IS, TURNED_ROUND])
def test_a_picture_that_is_not_mirrored_is_not_told(swapped: tuple[int, int, int], late_s: float) -> None:
    assert said(swapped, late_s=late_s) == []


def test_a_heading_that_swings_seen_late_is_not_taken_for_a_mirror() -> None:
    assert said(AS_IT_IS, late_s=0.5, attitude_at=wobbling_at) == []


def test_little_turning_says_nothing() -> None:
    assert said(LEFT_FOR_RIGHT, seconds=3) == []
    assert FEWEST * 0.25 < 3


def test_a_turn_that_was_taken_when_no_attitude_is_known_says_nothing() -> None:
    watch = MirrorWatch(ClockOffset(), AttitudeBuffer())
    assert watch.on_turn(Turn(0, S, LEVEL, COV), LEVEL) == []
