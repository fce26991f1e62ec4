from __future__ import annotations

import math

import pytest

from visloc_companion.core.velocity.heading_pull import FIXES, MAX_GAP_NS, HeadingPull
from visloc_companion.geo import se3
from visloc_companion.types import Odometry

STEP_NS = 20_000_000
LEAN_RAD = 0.4


def flown(pull: HeadingPull, from_s: float, to_s: float, yaw_radps: float, pulled_radps: float = 0.0) -> None:
    """A banked turn at a rate, while a compass pulls the heading at another."""
    for k in range(round(from_s * 50), round(to_s * 50)):
        t_s = k * STEP_NS * 1e-9
        q = se3.quat_from_euler(LEAN_RAD, 0.1, (yaw_radps + pulled_radps) * t_s)
        down = yaw_radps * math.cos(0.1)
        rate = (-yaw_radps * math.sin(0.1), down * math.sin(LEAN_RAD), down * math.cos(LEAN_RAD))
        pull.on_attitude(k * STEP_NS, q, rate)


def test_turns_that_the_gyroscopes_tell_are_no_pull() -> None:
    pull = HeadingPull()
    flown(pull, 0.0, 30.0, yaw_radps=0.7)
    assert pull.since_fixes_rad < 1e-3


def test_what_a_compass_turns_the_heading_by_is_one_until_fixes_bear_the_heading_out() -> None:
    pull = HeadingPull()
    flown(pull, 0.0, 5.0, yaw_radps=-0.5, pulled_radps=math.radians(6.0))
    assert math.degrees(pull.since_fixes_rad) == pytest.approx(30.0, abs=1.0)
    for n in range(FIXES):
        pull.borne_out()
        assert (pull.since_fixes_rad < 1e-9) is (n == FIXES - 1)


def test_what_was_not_heard_is_no_pull() -> None:
    pull = HeadingPull()
    level = (0.0, 0.0, 0.0)
    pull.on_attitude(0, se3.quat_from_euler(0.0, 0.0, 0.0), level)
    pull.on_attitude(MAX_GAP_NS + 1, se3.quat_from_euler(0.0, 0.0, 1.0), level)
    pull.interrupted()
    pull.on_attitude(2 * MAX_GAP_NS, se3.quat_from_euler(0.0, 0.0, 2.0), level)
    assert pull.since_fixes_rad == 0.0


def test_the_variance_grows_by_what_was_not_told_yet() -> None:
    pull = HeadingPull()
    assert pull.more_rad2() == 0.0
    flown(pull, 0.0, 2.0, 0.0, pulled_radps=0.1)
    assert pull.more_rad2() == pytest.approx(0.04, rel=0.05)
    assert pull.more_rad2() == 0.0
    flown(pull, 2.0, 4.0, 0.0, pulled_radps=0.1)
    assert pull.more_rad2() == pytest.approx(0.16 - 0.04, rel=0.1)
    for _ in range(FIXES):
        pull.borne_out()
    flown(pull, 4.0, 5.0, 0.0, pulled_radps=0.1)
    assert pull.more_rad2() == pytest.approx(0.01, rel=0.05)


def test_a_displacement_is_doubted_across_its_way() -> None:
    pull = HeadingPull()
    seen = Odometry(2, 1, 2, (30.0, 40.0, 0.0), ((0.2, 0.01), (0.01, 0.3)), 0.01, 0.02)
    assert pull.doubted(seen) == seen
    flown(pull, 0.0, 3.0, 0.0, pulled_radps=0.1)
    doubted, more = pull.doubted(seen), pull.since_fixes_rad**2
    assert doubted.sigma_heading_rad == pytest.approx(math.sqrt(0.02**2 + more))
    assert doubted.cov_ne_m2[0] == pytest.approx((0.2 + more * 1600, 0.01 - more * 1200))
    assert doubted.cov_ne_m2[1] == pytest.approx((0.01 - more * 1200, 0.3 + more * 900))


def test_steep_attitudes_whose_heading_says_nothing_are_no_pull() -> None:
    """Of a vehicle that points straight down heading and roll are one; what follows does not follow on what was before."""
    pull, still = HeadingPull(), (0.0, 0.0, 0.0)
    for k, (pitch, yaw) in enumerate(((0.1, 0.0), (-1.55, 2.0), (-1.55, -1.0), (0.1, 0.9), (0.1, 0.9))):
        pull.on_attitude(k * STEP_NS, se3.quat_from_euler(0.0, pitch, yaw), still)
        assert pull.since_fixes_rad < 1e-6
