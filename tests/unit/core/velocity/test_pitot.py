from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.core.velocity.air_velocity import AirVelocity
from visloc_companion.core.velocity.pitot import ENOUGH, Airspeed, PitotLearner, true_airspeed_mps

S = 1_000_000_000
EXACT = np.zeros((2, 2))
SCALE, WIND, SPEED = 1.1, np.array([3.0, -6.0]), 20.0
COURSES = (0.0, 1.6, 3.1, -1.5)


def measured(t_s: int, heading: float, rng: np.random.Generator) -> tuple[Airspeed, tuple[float, float, float]]:
    """A tube that reads a tenth too little."""
    along = np.array([math.cos(heading), math.sin(heading)])
    north, east = ((SPEED / SCALE) * along + 0.3 * rng.standard_normal(2)).tolist()
    v_north, v_east = (SPEED * along + WIND).tolist()
    return Airspeed(t_s * S, (north, east)), (v_north, v_east, 0.0)


def taught(courses: tuple[float, ...], seconds: int = 120, seed: int = 1) -> PitotLearner:
    learner, rng = PitotLearner(), np.random.default_rng(seed)
    for t in range(seconds):
        learner.learn(*measured(t, courses[t // 30 % len(courses)], rng), EXACT)
    return learner


def told(learner: PitotLearner, t_s: int, heading: float) -> tuple[AirVelocity, float]:
    """What it tells, and how far that is off."""
    air, (v_north, v_east, _) = measured(t_s, heading, np.random.default_rng(t_s))
    found = learner.velocity(air)
    assert found is not None
    return found, math.hypot(found.v_ne_mps[0] - v_north, found.v_ne_mps[1] - v_east)


def test_scale_and_wind_are_told_apart_by_turning() -> None:
    found, off_mps = told(taught(COURSES), 130, 0.7)
    assert off_mps < 1.0
    assert math.sqrt(np.trace(found.error_m2ps2) / 2) < 0.9, "a heading that is 2 degrees off makes 0.7 of it"
    assert found.holds


def test_one_course_tells_the_velocity_on_that_course_alone() -> None:
    learner = taught((0.0,))
    same, off_mps = told(learner, 121, 0.0)
    assert off_mps < 1.0
    assert same.holds
    turned, off_mps = told(learner, 122, math.pi)
    assert off_mps > 2.0
    assert not turned.holds
    assert turned.doubt_m2ps2 is not None
    assert off_mps**2 < 9 * np.trace(turned.doubt_m2ps2)


@pytest.mark.parametrize("off_rad", [-0.06, 0.06])
def test_a_heading_that_is_off_is_taken_for_wind_and_doubted_on_another_course(off_rad: float) -> None:
    """Learned on courses within 100 degrees, 3.4 degrees made 1.3 m/s of wind, and the velocity was off by up to 2.8 m/s, sure to
    0.2 to 0.6."""
    learner, rng = PitotLearner(), np.random.default_rng(1)

    def turned(t_s: int, course: float) -> tuple[Airspeed, tuple[float, float, float]]:
        air, v_ned_mps = measured(t_s, course, rng)
        (north, east), c, s = air.v_ne_mps, math.cos(off_rad), math.sin(off_rad)
        return Airspeed(air.t_boot_ns, (c * north - s * east, s * north + c * east)), v_ned_mps

    for t_s in range(90):
        learner.learn(*turned(t_s, (0.0, 0.9, 1.7)[t_s // 30]), EXACT)
    for course in (1.7, 3.5, 4.5):
        learner.filter_restarted()
        air, (v_north, v_east, _) = turned(100, course)
        found = learner.velocity(air)
        assert found is not None
        off_mps = np.array(found.v_ne_mps) - (v_north, v_east)
        claimed = found.error_m2ps2 + found.noise_m2ps2
        assert off_mps @ np.linalg.solve(claimed, off_mps) < 9.0


def test_doubt_begins_anew_with_the_filter() -> None:
    learner = taught(COURSES)
    assert told(learner, 121, 0.0)[0].doubt_m2ps2 is None
    assert told(learner, 122, 0.0)[0].doubt_m2ps2 is not None
    learner.filter_restarted()
    assert told(learner, 123, 0.0)[0].doubt_m2ps2 is None


def test_says_nothing_before_it_has_learned() -> None:
    learner = taught(COURSES, ENOUGH - 1)
    assert learner.velocity(Airspeed(ENOUGH * S, (20.0, 0.0))) is None


def test_a_reading_beyond_all_others_is_not_learned() -> None:
    learner = taught(COURSES)
    before, _ = told(learner, 121, 0.3)
    learner.learn(Airspeed(122 * S, (60.0, 0.0)), (23.0, -6.0, 0.0), EXACT)
    after, _ = told(learner, 121, 0.3)
    assert after.v_ne_mps == before.v_ne_mps


def test_true_airspeed_of_the_standard_atmosphere() -> None:
    density = 1.225
    assert true_airspeed_mps(1013.25, density * 25**2 / 200) == pytest.approx(25.0, rel=1e-3)
    assert true_airspeed_mps(898.76, 1.1117 * 25**2 / 200) == pytest.approx(25.0, rel=1e-3)
    assert true_airspeed_mps(1013.25, -0.2) == 0.0
    assert true_airspeed_mps(0.0, 1.0) == 0.0
    assert np.isfinite(true_airspeed_mps(1.0, 1000.0))
