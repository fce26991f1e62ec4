from __future__ import annotations

import math

import pytest

from visloc_companion.core.satellites.drift import DriftTest

S = 1_000_000_000
FIX_VAR, COMMON_VAR = 1.5**2, 0.25 + 0.5


def fed(test: DriftTest, t_s: float, north: float, east: float = 0.0) -> float:
    result = test.add(round(t_s * S), (north, east), FIX_VAR, COMMON_VAR)
    return -math.inf if result is None else result.log_r


def test_blocks_of_a_second_whatever_the_rate() -> None:
    test = DriftTest(1.5)
    finished = [k for k in range(50) if fed(test, 0.2 * k, 0.0) > -math.inf]
    assert finished == [0, 5, 10, 15, 20, 25, 30, 35, 40, 45]
    slow = DriftTest(1.5)
    assert all(fed(slow, 2.0 * k, 0.0) > -math.inf for k in range(10))


def test_a_stale_half_block_is_thrown_away() -> None:
    test = DriftTest(1.5)
    fed(test, 0.0, 0.0)
    assert fed(test, 0.5, 1000.0) == -math.inf
    assert fed(test, 100.0, 0.0) < 5.0


def test_a_constant_offset_is_learned_and_never_suspected() -> None:
    test = DriftTest(1.5)
    assert max(fed(test, float(k), 2.0, -2.5) for k in range(600)) < 6.0
    assert test.bias_m == pytest.approx((2.0, -2.5), abs=0.2)


@pytest.mark.parametrize("heading_deg", [0, 22.5, 100, 225])
def test_a_drag_is_found_in_any_direction(heading_deg: float) -> None:
    test = DriftTest(1.5)
    for k in range(300):
        fed(test, float(k), 0.0)
    c, s = math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg))
    pulled = next(d for d in range(1, 40) if fed(test, 300.0 + d, d * c, d * s) > 10.5)
    assert pulled <= 12


def test_a_probation_starts_from_what_was_learned_and_ends_in_trust_or_not() -> None:
    test = DriftTest(1.5)
    for k in range(300):
        fed(test, float(k), 2.0)
    test.lose()
    assert not test.in_probation
    test.probation(4e3)
    assert (test.in_probation, test.log_r) == (True, -math.inf)
    agreed = [fed(test, 320.0 + k, 2.0) for k in range(25)]
    assert agreed[-1] < agreed[0] < 10.0
    test.regain()
    assert not test.in_probation
    assert test.bias_m[0] == pytest.approx(2.0, abs=0.3)
    test.lose()
    test.probation(4e3)
    assert [fed(test, 360.0 + k, -10.0) for k in range(6)][-1] > 12.0
    test.probation(4e3)  # once more from the same start: nothing of the false place was learned
    assert fed(test, 380.0, 2.0) < 10.0
