from __future__ import annotations

import math

import pytest

from visloc_companion.core.drift import MAX_BIAS_M, DriftTest

S = 1_000_000_000
FIX_VAR, COMMON_VAR = 1.5**2, 1.5**2 + 0.25 + 1.0


def fed(test: DriftTest, t_s: float, north: float, east: float = 0.0, learn: bool = True) -> float:
    result = test.add(round(t_s * S), (north, east), FIX_VAR, COMMON_VAR, learn)
    return -1.0 if result is None else result.largest_sum


def test_blocks_of_a_second_whatever_the_rate() -> None:
    test = DriftTest(3.0, 12.0)
    finished = [k for k in range(50) if fed(test, 0.2 * k, 0.0) >= 0]
    assert finished == [0, 5, 10, 15, 20, 25, 30, 35, 40, 45]
    slow = DriftTest(3.0, 12.0)
    assert all(fed(slow, 2.0 * k, 0.0) >= 0 for k in range(10))


def test_a_stale_half_block_is_thrown_away() -> None:
    test = DriftTest(3.0, 12.0)
    fed(test, 0.0, 0.0)
    assert fed(test, 0.5, 1000.0) == -1.0
    assert fed(test, 100.0, 0.0) == 0.0


def test_a_constant_offset_within_bounds_is_learned_and_never_suspected() -> None:
    test = DriftTest(3.0, 12.0)
    sums = [fed(test, float(k), 2.0, -2.5) for k in range(600)]
    assert max(sums) == 0.0
    assert test.bias_m == pytest.approx((2.0, -2.5), abs=0.1)


def test_the_bias_is_bounded_and_only_learned_when_told() -> None:
    test = DriftTest(3.0, 12.0)
    for k in range(2000):
        fed(test, float(k), min(0.02 * k, 8.0))
    assert math.hypot(*test.bias_m) <= MAX_BIAS_M + 1e-9
    deaf = DriftTest(3.0, 12.0)
    for k in range(100):
        fed(deaf, float(k), 2.0, learn=False)
    assert deaf.bias_m == (0.0, 0.0)


@pytest.mark.parametrize("heading_deg", [0, 22.5, 100, 225])
def test_a_drag_is_found_in_any_direction(heading_deg: float) -> None:
    test = DriftTest(3.0, 12.0)
    for k in range(300):
        fed(test, float(k), 0.0)
    c, s = math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg))
    pulled = next(d for d in range(1, 40) if fed(test, 300.0 + d, d * c, d * s) > 12.0)
    assert pulled <= 13
    assert test.largest_sum > 12.0


def test_one_wild_comparison_does_not_decide_and_the_sums_come_down_again() -> None:
    test = DriftTest(3.0, 12.0)
    for k in range(60):
        fed(test, float(k), 0.0)
    assert 0 < fed(test, 60.0, 500.0) < 12.0
    assert fed(test, 61.0, 0.0) < 1.0
    for k in range(100):
        fed(test, 62.0 + k, 500.0)
    assert test.largest_sum == 24.0
    assert fed(test, 170.0, 0.0, learn=False) > 12.0
    assert fed(test, 171.0, 0.0, learn=False) < 12.0
