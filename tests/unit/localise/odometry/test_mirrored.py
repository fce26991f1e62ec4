"""From mirrored frames to the word that they are: turns are found in them, and contradict the autopilot."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera.mirror_watch import MirrorWatch
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.localise.odometry.rotation import TurnWatch
from visloc_companion.types import Image, Notice, Quat

LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
N = 18


@pytest.fixture(scope="module")
def frames(odo, field) -> list[tuple[Image, Quat]]:
    """On the way at 8 m/s, turning by 16°/s."""
    eulers = [(2.0 * math.sin(k), 1.5 * math.cos(1.3 * k), 4.0 * k) for k in range(N)]
    pictures = [field.frame((2.0 * k, 0.0, -100.0), euler, seed=k) for k, euler in enumerate(eulers)]
    return [(p, quat_from_euler(*map(math.radians, e))) for p, e in zip(pictures, eulers, strict=True)]


@pytest.mark.parametrize(
    ("changed", "told"),
    [(np.fliplr, True), (np.flipud, True), (lambda frame: frame, False), (lambda frame: np.rot90(frame, 2), False)],
    ids=["left for right", "top for bottom", "as it is", "upside down"],
)
def test_a_turning_camera_shows_whether_it_is_mirrored(odo, frames, changed: Callable[[Image], Image], told: bool) -> None:
    clock, attitude = ClockOffset(), AttitudeBuffer()
    turns, watch, said = TurnWatch(odo.MODEL), MirrorWatch(clock, attitude), []
    for k, (pixels, q) in enumerate(frames, start=1):
        t_ns = k * odo.PERIOD_NS
        clock.on_arrival(t_ns, t_ns)
        attitude.add(t_ns, q, (0.0, 0.0, 0.0))
        turn = turns.step(np.ascontiguousarray(changed(pixels)), t_ns, q).since_last
        said += [] if turn is None else watch.on_turn(turn, LEVEL)
    assert [notice.text for notice in said if isinstance(notice, Notice)] == ["visloc: picture is mirrored, NOT USED"] * told
