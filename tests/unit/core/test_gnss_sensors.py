"""GNSS against odometry and barometer, and the track of displacements."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.core.satellites.gnss_height import HeightTest, pressure_altitude_m
from visloc_companion.core.satellites.gnss_odometry import Lens, OdometryTest
from visloc_companion.types import Baro, GeoPoint

S = 1_000_000_000
HERE = GeoPoint(59.0, 18.0, 50.0)
LIMIT = 10.5


class Walk:
    """A vehicle that turns; odometry with an error of scale (a share) and one of heading (degrees)."""

    def __init__(
        self, seed: int = 1, speed: float = 12.0, scale: float = 0.01, heading_deg: float = 1.0, turn_rad: float = 1.3
    ) -> None:
        self.turn_rad = turn_rad
        self.factor = (1 + scale) * np.exp(1j * math.radians(heading_deg))
        self.rng, self.test, self.t, self.speed = np.random.default_rng(seed), OdometryTest(), 0, speed

    def run(self, seconds: int, drag: complex = 0j, jump: complex = 0j, zoom_per_s: float = 0.0) -> list[float]:
        """`zoom_per_s`: how fast, natural logarithm, a lens zooms that nobody sees, and that is known."""
        out = []
        for k in range(seconds):
            v = self.speed * np.exp(1j * (self.t // 40) * self.turn_rad)
            gnss = v + drag + jump + 0.2 * complex(*self.rng.standard_normal(2))
            seen = v * self.factor * math.exp(k * zoom_per_s) + 0.1 * complex(*self.rng.standard_normal(2))
            jump = 0j
            lens = Lens(zoom_share=min(1.2, math.expm1(k * abs(zoom_per_s))))
            self.test.add(self.t * S, (self.t + 1) * S, (gnss.real, gnss.imag), (seen.real, seen.imag), 0.2**2, lens)
            self.t += 1
            out.append(self.test.log_r)
        return out


def test_odometry_learns_its_scale_and_heading_in_turns() -> None:
    assert max(Walk().run(600)) < LIMIT - 2


@pytest.mark.parametrize(("scale", "heading_deg"), [(0.03, 0.0), (-0.03, 1.0), (0.0, 3.0), (0.03, -3.0)])
def test_a_wrong_lens_or_compass_is_no_false_gnss_and_hides_none(scale: float, heading_deg: float) -> None:
    """A focal length wrong by 3 % lasts; so does a heading wrong by 3 degrees."""
    walk = Walk(scale=scale, heading_deg=heading_deg)
    assert max(walk.run(1800)) < LIMIT - 2
    assert next(k for k, value in enumerate(walk.run(60, -0.7 + 0.7j)) if value > LIMIT) <= 12


@pytest.mark.parametrize(("drag", "within_s"), [(1.0 + 0j, 12), (-0.7 + 0.7j, 12), (3j, 6)])
def test_a_drag_that_the_camera_does_not_see_is_found(drag: complex, within_s: int) -> None:
    walk = Walk()
    walk.run(200)
    assert next(k for k, value in enumerate(walk.run(60, drag)) if value > LIMIT) <= within_s


@pytest.mark.parametrize("per_s", [0.01, 0.025, -0.025, 0.04])
def test_a_zoom_that_nobody_sees_is_no_false_gnss_and_hides_none_that_goes_aside(per_s: float) -> None:
    walk = Walk(turn_rad=0.02)
    walk.run(200)
    assert max(walk.run(40, zoom_per_s=per_s)) < LIMIT - 2
    walk = Walk(turn_rad=0.02)
    walk.run(200)
    aside = np.exp(1j * (200 // 40 * 0.02 + math.pi / 2))
    assert next(k for k, value in enumerate(walk.run(60, aside, zoom_per_s=per_s)) if value > LIMIT) <= 12


def test_a_jump_is_found_although_the_velocity_is_true_again() -> None:
    walk = Walk()
    walk.run(200)
    assert max(walk.run(12, jump=80 + 0j)) > LIMIT


@pytest.mark.parametrize(("jump", "after_s"), [(25 + 0j, 600), (50j, 1800), (-50 + 0j, 5400)])
def test_a_jump_is_found_after_a_long_way_as_soon_as_after_a_short_one(jump: complex, after_s: int) -> None:
    """An error of scale changes what odometry sees from then on, not the way behind it: of 7 km and more that hid the jump."""
    walk = Walk(turn_rad=0.02)
    assert max(walk.run(after_s)) < LIMIT - 2
    assert max(walk.run(12, jump=jump)) > LIMIT


def test_after_a_hole_the_sums_begin_anew_and_forgetting_keeps_the_scale() -> None:
    walk = Walk()
    walk.run(100)
    walk.run(5, jump=500j)
    walk.t += 60
    walk.test.forget()
    assert walk.test.log_r == -math.inf
    assert max(walk.run(60)) < LIMIT


def test_pressure_altitude_of_the_standard_atmosphere() -> None:
    assert pressure_altitude_m(1013.25) == 0.0
    assert pressure_altitude_m(898.76) == pytest.approx(1000.0, abs=1.0)


def pressure(h_m: float) -> float:
    return 1013.25 * (1 - h_m / 44330.77) ** (1 / 0.190263)


class Climb:
    """GNSS height, with an unknown constant to the barometer's, through climbs in air that is 15 degrees too warm."""

    def __init__(self) -> None:
        self.rng, self.test, self.t = np.random.default_rng(2), HeightTest(), 0

    def run(self, seconds: int, false_m: float = 0.0, rate: float = 0.0) -> list[float]:
        out = []
        for _ in range(seconds):
            h = 120 + 60 * math.sin(self.t / 50)
            self.test.on_baro(Baro(self.t * S, 0, pressure(0.95 * h + 40 + 0.3 * self.rng.standard_normal()), 30.0))
            false_m += rate
            self.test.on_gnss(self.t * S, h + false_m + self.rng.standard_normal(), 1.5)
            self.t += 1
            out.append(self.test.log_r)
        return out


def test_climbs_in_warm_air_are_healthy_and_false_heights_are_not() -> None:
    climb = Climb()
    assert max(climb.run(600)) < LIMIT - 2
    assert max(climb.run(20, false_m=60.0)) > LIMIT
    climb.test.forget()
    assert climb.test.log_r == -math.inf
    lifted = Climb()
    lifted.run(300)
    assert max(lifted.run(60, rate=2.0)) > LIMIT


def test_no_height_is_judged_without_a_fresh_and_possible_pressure() -> None:
    test = HeightTest()
    test.on_gnss(S, 50.0, None)
    test.on_baro(Baro(S, 0, 5.0, 15.0))
    test.on_gnss(2 * S, 50.0, None)
    test.on_baro(Baro(2 * S, 0, 1000.0, 15.0))
    test.on_gnss(9 * S, 50.0, None)
    assert test.log_r == -math.inf


def test_what_a_receiver_gave_for_a_height_before_is_no_measure_after_it_is_learned_anew() -> None:
    """A constant that jumps by 60 m is false, unless what it is held against begins anew: then it is another constant."""
    for anew in (False, True):
        climb = Climb()
        climb.run(100)
        assert climb.test.log_r > -math.inf
        if anew:
            climb.test.learn_anew()
            assert climb.test.log_r == -math.inf
        assert (max(climb.run(20, false_m=60.0)) > LIMIT) is not anew
