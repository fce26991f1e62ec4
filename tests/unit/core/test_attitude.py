from __future__ import annotations

import math

import pytest

from visloc_companion.core.attitude import AttitudeBuffer, turned
from visloc_companion.errors import Reason
from visloc_companion.geo import se3

MS = 1_000_000
LEVEL = (1.0, 0.0, 0.0, 0.0)
STILL = (0.0, 0.0, 0.0)


def test_interpolates_a_constant_turn_exactly() -> None:
    buffer = AttitudeBuffer()
    rate = 0.7
    for k in range(20):
        assert buffer.add(k * 20 * MS, se3.quat_from_euler(0, 0, rate * k * 0.02), (0.0, 0.0, rate)) is None
    got = buffer.at(133 * MS)
    assert got is not None
    assert se3.angle_between(got, se3.quat_from_euler(0, 0, rate * 0.133)) < 1e-7


@pytest.mark.parametrize("offset_ms", [-80, 80])
def test_extrapolates_with_rates_either_way(offset_ms: int) -> None:
    buffer = AttitudeBuffer()
    rates = (0.3, -0.2, 0.5)
    start = se3.quat_from_euler(0.1, 0.2, 0.3)
    buffer.add(1000 * MS, start, rates)
    got = buffer.at((1000 + offset_ms) * MS)
    assert got is not None
    q = start
    for _ in range(1000):  # integrates the kinematics in small steps
        q = se3.quat_multiply(q, se3.normalised((1.0, *(r * offset_ms * 1e-3 / 2000 for r in rates))))
    assert se3.angle_between(got, q) < 1e-5


def test_gives_nothing_where_no_sample_is_near() -> None:
    buffer = AttitudeBuffer()
    assert buffer.at(0) is None
    assert buffer.newest_boot_ns() is None
    buffer.add(1000 * MS, LEVEL, STILL)
    assert buffer.at(1101 * MS) is None
    assert buffer.at(899 * MS) is None
    buffer.add(2000 * MS, LEVEL, STILL)
    assert buffer.at(1500 * MS) is None  # a gap of a second is not bridged
    assert buffer.at(1950 * MS) == LEVEL
    assert buffer.newest_boot_ns() == 2000 * MS


def test_rejects_time_going_back_and_broken_samples() -> None:
    buffer = AttitudeBuffer()
    assert buffer.add(1000 * MS, LEVEL, STILL) is None
    assert buffer.add(1000 * MS, LEVEL, STILL) is Reason.IMPLAUSIBLE_TIME
    assert buffer.add(900 * MS, LEVEL, STILL) is Reason.IMPLAUSIBLE_TIME
    assert buffer.add(1100 * MS, (math.nan, 0.0, 0.0, 0.0), STILL) is Reason.NOT_FINITE
    assert buffer.add(1100 * MS, (0.0, 0.0, 0.0, 0.0), STILL) is Reason.NOT_FINITE
    assert buffer.add(1100 * MS, LEVEL, (0.0, math.inf, 0.0)) is Reason.NOT_FINITE
    assert buffer.add(1100 * MS, LEVEL, STILL) is None


def test_memory_is_bounded_and_can_be_cleared() -> None:
    buffer = AttitudeBuffer()
    for k in range(1000):
        buffer.add(k * 20 * MS, LEVEL, STILL)
    assert buffer.at(0) is None
    assert buffer.at(15_000 * MS) == LEVEL
    buffer.clear()
    assert buffer.at(19_980 * MS) is None
    assert buffer.add(0, LEVEL, STILL) is None


def test_no_rate_turns_nothing() -> None:
    assert turned(LEVEL, STILL, 0.1) == LEVEL


def test_mean_rates_over_a_span_are_those_of_the_turn() -> None:
    buffer, rate = AttitudeBuffer(), (0.4, -0.2, 0.1)
    for k in range(11):
        t_s = 0.02 * k
        buffer.add(round(t_s * 1e9), se3.quat_from_vector((0.4 * t_s, -0.2 * t_s, 0.1 * t_s)), rate)
    assert buffer.rate_frd_radps(100_000_000, 50_000_000) == pytest.approx(rate, abs=1e-6)
    assert buffer.rate_frd_radps(200_000_000, 50_000_000) == pytest.approx(rate, abs=1e-6), "its end is turned on by the newest"
    assert buffer.rate_frd_radps(900_000_000, 50_000_000) is None
