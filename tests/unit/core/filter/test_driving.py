from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from visloc_companion.core.filter.driving import MAX_CLIMB_HELD_S, Velocity, height_at, mean_and_change, velocity_at
from visloc_companion.core.filter.propagation import Drive

S = 1_000_000_000
BEFORE = Velocity(S, (10.0, 0.0, -2.0), 500.0, 0.3, Drive.AUTOPILOT)
AFTER = Velocity(3 * S, (12.0, -4.0, 0.0), 510.0, 0.3, Drive.AUTOPILOT)


def test_between_two_samples_both_are_interpolated() -> None:
    assert velocity_at(2 * S, (BEFORE, AFTER)) == (11.0, -2.0)
    assert height_at(2 * S, (BEFORE, AFTER)) == 505.0


def test_after_the_last_the_velocity_is_held_and_the_climb_for_a_while() -> None:
    assert velocity_at(9 * S, (BEFORE, None)) == (10.0, 0.0)
    assert height_at(S + S // 2, (BEFORE, None)) == pytest.approx(501.0)
    assert height_at(9 * S, (BEFORE, None)) == pytest.approx(500.0 + 2.0 * MAX_CLIMB_HELD_S)


INERTIAL = replace(BEFORE, drive=Drive.INERTIAL, sigma_a_mps2=0.2)


def test_an_integrated_velocity_does_not_lead_to_the_autopilots_own() -> None:
    soon = replace(AFTER, t_ns=S + S // 2)
    assert velocity_at(S + S // 4, (INERTIAL, soon)) == (10.0, 0.0)


def test_over_a_gap_it_does_for_the_vehicle_may_have_turned() -> None:
    assert velocity_at(2 * S, (INERTIAL, AFTER)) == (11.0, -2.0)
    assert velocity_at(2 * S, (INERTIAL, replace(AFTER, drive=Drive.FED_BACK))) == (11.0, -2.0)


def test_nothing_leads_to_a_velocity_that_nobody_knows() -> None:
    assert velocity_at(2 * S, (INERTIAL, replace(AFTER, drive=Drive.NONE))) == (10.0, 0.0)
    assert velocity_at(2 * S, (replace(BEFORE, drive=Drive.NONE), AFTER)) == (10.0, 0.0)


MPS, TIMES = st.floats(-200.0, 200.0), st.integers(0, 5 * S)
SAMPLES = st.builds(Velocity, TIMES, st.tuples(MPS, MPS, MPS), st.just(500.0), st.just(0.3), st.sampled_from(list(Drive)))


@given(SAMPLES, st.none() | SAMPLES, TIMES, TIMES)
def test_mean_and_change_are_those_of_both_ends(before: Velocity, after: Velocity | None, from_ns: int, to_ns: int) -> None:
    (n0, e0), (n1, e1) = velocity_at(from_ns, (before, after)), velocity_at(to_ns, (before, after))
    assert mean_and_change(from_ns, to_ns, (before, after)) == (((n0 + n1) / 2, (e0 + e1) / 2), (n1 - n0, e1 - e0))
