"""The simulated rangefinder and the message that carries it."""

from __future__ import annotations

import math
from random import Random

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.sim.vehicles.rangefinder import Rangefinder
from visloc_companion.types import GeoPoint, Quat

HOME = GeoPoint(47.3977, 8.5456, 488.0)
HIGH = GeoPoint(47.3977, 8.5456, 588.0)
LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)


def quiet(surface, **more: float) -> Rangefinder:  # type: ignore[no-untyped-def]
    return Rangefinder(surface, sigma_m=0.0, sigma_share=0.0, **more)


def test_straight_down_it_measures_the_height() -> None:
    assert quiet(lambda place: 488.0).measured_m(HIGH, LEVEL, Random(1)) == pytest.approx(100.0)


def test_a_tilted_beam_meets_the_slope_where_it_leads() -> None:
    def slope(place: GeoPoint) -> float:
        return 488.0 + 0.2 * ned_from_geo(place, HOME)[1]

    roll = math.radians(15)
    d = quiet(slope).measured_m(HIGH, quat_from_euler(roll, 0.0, 0.0), Random(1))
    assert d is not None
    assert 588.0 - d * math.cos(roll) == pytest.approx(488.0 - 0.2 * d * math.sin(roll), abs=0.01)


@pytest.mark.parametrize("surface_m", [100.0, 600.0, math.nan])
def test_out_of_reach_or_nothing_back_is_no_distance(surface_m: float) -> None:
    assert quiet(lambda place: surface_m).measured_m(HIGH, LEVEL, Random(1)) is None


def test_its_noise_is_what_it_says() -> None:
    sensor, rng = Rangefinder(lambda place: 488.0, sigma_m=0.2, sigma_share=0.001), Random(3)
    got = np.array([sensor.measured_m(HIGH, LEVEL, rng) for _ in range(2000)], dtype=float)
    assert got.mean() == pytest.approx(100.0, abs=0.03)
    assert got.std() == pytest.approx(0.3, rel=0.06)


@pytest.mark.parametrize(("surface_m", "within"), [(488.0, True), (0.0, False)])
def test_the_autopilot_sends_it_to_who_asks(companion, surface_m, within):
    flight = companion(sending=False, rangefinder=Rangefinder(lambda place: surface_m))
    heard = []
    listen = flight.pilot.outgoing

    def outgoing() -> bytes:
        data = listen()
        heard.extend(m for m in mavlink.MAVLink(None).parse_buffer(data) or [] if m.get_type() == "DISTANCE_SENSOR")
        return data

    flight.pilot.outgoing = outgoing
    flight.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR, 100_000)
    flight.fly(3.0)
    assert 28 <= len(heard) <= 32
    assert all(m.orientation == mavlink.MAV_SENSOR_ROTATION_PITCH_270 for m in heard)
    assert all((m.min_distance <= m.current_distance <= m.max_distance) is within for m in heard)


def test_without_one_the_autopilot_accepts_and_sends_nothing(companion):
    flight = companion(sending=False)
    flight.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR, 100_000)
    assert flight.fly(2.0).heard["DISTANCE_SENSOR"] == 0
