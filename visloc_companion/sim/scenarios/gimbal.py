"""Flights without GNSS in which a gimbal carries the camera."""

from __future__ import annotations

import math

from visloc_companion.sim import faults
from visloc_companion.sim.scenarios.base import Expectation, Scenario, by_name
from visloc_companion.sim.scenarios.world import JAM_S, RATE_HZ
from visloc_companion.sim.vehicles.gimbal import GimbalPlan
from visloc_companion.types import Mode

DOWN_RAD = -math.pi / 2
BLIND = Expectation(
    max_error_m=15.0, dead_reckoning_m=40.0, modes=(Mode.AIDING, Mode.DEAD_RECKONING, Mode.AIDING), plane_max_error_m=30.0
)

GIMBAL: dict[str, Scenario] = by_name(
    Scenario(
        "gimbal",
        "A gimbal holds the camera straight down, and says how.",
        60.0,
        faults.jam(JAM_S),
        frame_rate_hz=RATE_HZ,
        pictures=True,
        gimbal=GimbalPlan(),
    ),
    Scenario(
        "gimbal_silent",
        "For 12 s nobody says where the camera's gimbal points.",
        65.0,
        faults.jam(JAM_S) + faults.these(faults.GimbalSilence(30.0, 42.0)),
        BLIND,
        frame_rate_hz=RATE_HZ,
        pictures=True,
        gimbal=GimbalPlan(),
    ),
    Scenario(
        "gimbal_to_horizon",
        "The camera's gimbal turns up to the horizon for 10 s, and back to 25 degrees from straight down.",
        65.0,
        faults.jam(JAM_S),
        BLIND,
        frame_rate_hz=RATE_HZ,
        pictures=True,
        gimbal=GimbalPlan(pitches_rad=((0.0, DOWN_RAD), (30.0, 0.0), (40.0, math.radians(-65.0)))),
    ),
)
