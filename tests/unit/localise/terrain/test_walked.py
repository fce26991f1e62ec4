from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.localise.terrain.walked import walked


def test_over_a_stretch_it_is_a_twelfth_to_the_middle_and_a_third_to_the_end() -> None:
    age = np.linspace(0, 30, 3001)
    got = walked(np.full(3001, -0.7), age)
    assert (got.age_s, got.then_m2, got.now_m2) == pytest.approx((15.0, 30 / 12, 30 / 3), rel=2e-3)
    assert walked(np.zeros(3001), age) == pytest.approx(got, rel=2e-3), "none tells anything"


def test_one_sounding_knows_its_own_time_alone() -> None:
    assert walked(np.array([0.0, 2.0, 0.0]), np.array([9.0, 5.0, 1.0])) == pytest.approx((5.0, 0.0, 5.0))


def test_it_is_the_variance_of_walks_drawn() -> None:
    rng = np.random.default_rng(1)
    age = rng.uniform(0, 20, 60)
    weight = np.square(np.sin(age)) * (age < 12) + 0.1
    got = walked(weight, age)
    times = np.linspace(0, 20, 2001)
    walks = np.cumsum(rng.normal(0, np.sqrt(0.01), (4000, 2001)), axis=1)
    walks -= walks[:, :1]
    of_soundings = walks[:, np.searchsorted(times, age)]
    mean = of_soundings @ weight / weight.sum()
    assert np.var(mean) == pytest.approx(got.now_m2, rel=0.08)
    assert np.var(mean - walks[:, np.searchsorted(times, got.age_s)]) == pytest.approx(got.then_m2, rel=0.08)


def test_soundings_that_weigh_against_each_other_tell_no_height_of_a_time_to_come() -> None:
    got = walked(np.array([3.0, -2.0]), np.array([1.0, 4.0]))
    assert (got.age_s, got.then_m2) == pytest.approx((0.0, got.now_m2))


def test_soundings_that_weigh_against_each_other_tell_no_height_of_before_the_first_of_them() -> None:
    got = walked(np.array([-2.0, 3.0]), np.array([1.0, 4.0]))
    assert got.age_s == 4.0
