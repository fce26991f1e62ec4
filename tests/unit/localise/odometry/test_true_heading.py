"""A heading that fixes found is carried on by what pictures show of turns."""

from __future__ import annotations

import math

import pytest

from visloc_companion.geo import se3
from visloc_companion.localise.odometry.true_heading import AGE_NS, HEADINGS, MOST_FRAMES, SIGMA_RAD, TrueHeading
from visloc_companion.types import Quat, Turn

STEP_NS = 250_000_000
COV = ((1e-7, 0.0, 0.0), (0.0, 1e-7, 0.0), (0.0, 0.0, 1e-7))
LEANING = se3.quat_from_euler(math.radians(40.0), 0.0, 1.0)


def reported(true: Quat, clockwise_rad: float) -> Quat:
    """An attitude that a turn clockwise sets right."""
    return se3.quat_multiply(se3.quat_from_vector((0.0, 0.0, -clockwise_rad)), true)


def flown(heading: TrueHeading, off_rad: list[float], *, turns_rad: float = 0.0, seen: bool = True, first: int = 0) -> int:
    """Frames whose heading is off by so much, of a vehicle that turns by so much from one to the next; the last one's time."""
    last = None
    for k, off in enumerate(off_rad, first):
        true = se3.quat_multiply(se3.quat_from_vector((0.0, 0.0, turns_rad * k)), LEANING)
        turn = None
        if last is not None and seen:
            turn = Turn((k - 1) * STEP_NS, k * STEP_NS, se3.quat_multiply(se3.quat_inverse(last), true), COV)
        heading.seen(k * STEP_NS, reported(true, off), turn)
        last = true
    return k * STEP_NS


def test_it_is_that_of_the_frame_that_is_asked_for() -> None:
    heading, off = TrueHeading(), [0.02 * min(k, 3) + 0.01 * k for k in range(12)]
    for k in range(12):
        if k == 0:
            heading.seen(0, reported(LEANING, off[0]), None)
        else:
            turn = Turn((k - 1) * STEP_NS, k * STEP_NS, (1.0, 0.0, 0.0, 0.0), COV)
            heading.seen(k * STEP_NS, reported(LEANING, off[k]), turn)
        if k < HEADINGS:
            assert heading.at(k * STEP_NS, k * STEP_NS) is None
            heading.found(k * STEP_NS, off[k])
    for k in range(12):
        known = heading.at(k * STEP_NS, 11 * STEP_NS)
        assert known is not None
        assert known.turn_rad == pytest.approx(off[k], abs=1e-4)
        assert known.sigma_rad == pytest.approx(SIGMA_RAD, rel=1e-3)
    assert heading.at(11 * STEP_NS, AGE_NS + STEP_NS) is None


def test_without_turns_it_stays_what_fixes_found() -> None:
    heading = TrueHeading()
    now_ns = flown(heading, [0.05] * HEADINGS + [0.09] * 4, seen=False)
    for k in range(HEADINGS):
        heading.found(k * STEP_NS, 0.05)
    known = heading.at(now_ns, now_ns)
    assert known is not None
    assert known.turn_rad == pytest.approx(0.05, abs=1e-9)


def test_what_a_turn_is_off_by_is_claimed_for_a_camera_that_leans() -> None:
    heading = TrueHeading()
    flown(heading, [0.0] * HEADINGS)
    for k in range(HEADINGS):
        heading.found(k * STEP_NS, 0.0)
    now_ns = flown(heading, [0.0] * 16, turns_rad=math.radians(12.0), first=HEADINGS)
    known = heading.at(now_ns, now_ns)
    assert known is not None
    assert known.turn_rad == pytest.approx(0.0, abs=1e-4)
    across_rad = math.radians(12.0 * 15) * math.sin(math.radians(40.0)) ** 2
    assert known.sigma_rad == pytest.approx(math.hypot(SIGMA_RAD, 0.015 * across_rad), rel=0.05)


def test_a_frame_from_before_the_memory_has_the_oldest_for_its_own() -> None:
    heading = TrueHeading()
    off = [0.01] * 5 + [0.01 + 1e-4 * k for k in range(MOST_FRAMES)]
    now_ns = flown(heading, off)
    for _ in range(HEADINGS):
        heading.found(now_ns, off[-1])
    oldest, known = heading.at(5 * STEP_NS, now_ns), heading.at(0, now_ns)
    assert known == oldest
    assert known is not None
    assert known.turn_rad == pytest.approx(0.01, abs=1e-4)
