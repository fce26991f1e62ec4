"""A vehicle that stands on the ground shows nothing of what its accelerations get wrong in the air."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.propagation import Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.core.tracking import Tracker
from visloc_companion.geo import wgs84
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.types import Fix, GeoPoint

G, FLIES_S, ALONE_S, HZ = 9.80665, 60, 3, 10
ORIGIN = GeoPoint(47.4, 8.5, 400.0)
WANDERS_RAD = math.radians(1.2)
"""1-sigma of the roll of PX4's simulated vehicles in flight."""


def learned_mps2(stood_s: int, speed_mps: float = 0.0, height_m: float = 50.0) -> float:
    """1-sigma of what the accelerations get wrong, by a vehicle that has flown for a minute when the receiver is gone."""
    tracker, rng, tilt_rad = Tracker(NavigatorSettings()), np.random.default_rng(3), 0.0
    tracker.set_origin(ORIGIN)
    for k in range((stood_s + FLIES_S + ALONE_S) * HZ):
        t_ns, stands, alone = k * 1_000_000_000 // HZ, k < stood_s * HZ, k >= (stood_s + FLIES_S) * HZ
        place = wgs84.geo_from_ned((max(0.0, k / HZ - stood_s) * speed_mps, 0.0, 0.0), ORIGIN)
        tracker.height_above_home_m = 0.1 if stands else height_m
        drive = Drive.FED_BACK if alone else Drive.AUTOPILOT
        v_ned = (0.0 if stands else speed_mps, 0.0, 0.0)
        tracker.drive(Velocity(t_ns, v_ned, 400.0 + tracker.height_above_home_m, 0.8 if alone else 0.3, drive), t_ns, alone=alone)
        if k == 0:
            tracker.seed(0, place, 2.0)
        if not alone and k % HZ == 0:
            tracker.observe_gnss(t_ns, place, 1.0)
        if not alone and not stands and k % 5 == 0:
            cov = ((0.49, 0.0), (0.0, 0.49))
            tracker.observe(Fix(t_ns, t_ns, 1, 1, "t", place, (1.0, 0.0, 0.0, 0.0), cov, 1.0, 0.1, 0.0, 1.0))
        tilt_rad = 0.0 if stands else 0.98 * tilt_rad + 0.2 * WANDERS_RAD * rng.standard_normal()
        tracker.on_force(t_ns, (0.0, 0.0, -G), quat_from_euler(tilt_rad, 0.0, 0.0))
    assert tracker.belief is not None
    assert tracker.belief.drive is Drive.INERTIAL
    return tracker.belief.sigma_a_mps2


def test_claims_in_the_air_are_those_of_a_vehicle_that_never_stood() -> None:
    """After minutes on the ground PX4's simulated plane claimed 0.08 m/s2 for its first minute aloft; its roll errs by 0.21."""
    assert learned_mps2(150) == pytest.approx(learned_mps2(0), rel=0.15)


def test_a_low_flight_over_home_teaches() -> None:
    fast, slow = learned_mps2(0, speed_mps=15.0, height_m=1.0), learned_mps2(0)
    assert fast == pytest.approx(slow, rel=0.15)
