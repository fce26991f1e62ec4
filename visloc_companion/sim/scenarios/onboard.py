"""Flights without GNSS in which the autopilot's sensors, the clocks, the link or the worker go wrong."""

from __future__ import annotations

import math

from visloc_companion.sim import faults
from visloc_companion.sim.scenarios.base import Expectation, Scenario, by_name
from visloc_companion.sim.scenarios.world import FAULT_S, JAM_S, RATE_HZ
from visloc_companion.types import Mode

SILENT_PLANE_M = 32.0
"""How a plane turned within 4 s of silence nobody tells: where the velocity is not told its 1-sigma is 3 m/s on each axis
(core/filter/fusion.py), 13 m in 4 s with what was known before, and 95 % are within 2.45 of those."""

ONBOARD: dict[str, Scenario] = by_name(
    Scenario(
        "compass_error",
        "Within 10 s the autopilot's heading goes wrong by 20 degrees.",
        80.0,
        faults.jam(JAM_S) + faults.these(faults.CompassError(FAULT_S, math.radians(20.0))),
        Expectation(max_error_m=25.0, final_modes=(Mode.AIDING, Mode.DEAD_RECKONING)),
        frame_rate_hz=RATE_HZ,
        pictures=True,
    ),
    Scenario(
        "baro_drift",
        "Within 30 s the barometer's height goes wrong by 20 m; the vehicle, which flies on it, sinks.",
        75.0,
        faults.jam(JAM_S) + faults.these(faults.BaroDrift(FAULT_S, 20.0, 30.0)),
        Expectation(median_error_m=3.0, max_error_m=30.0, final_modes=(Mode.AIDING, Mode.DEAD_RECKONING)),
        frame_rate_hz=RATE_HZ,
        pictures=True,
    ),
    Scenario(
        "autopilot_clock_step",
        "The autopilot's time stamps jump 2 s forward, and 20 s later 5 s back.",
        100.0,
        faults.jam(30.0) + faults.these(faults.AutopilotClockStep(45.0, 2.0), faults.AutopilotClockStep(65.0, -5.0)),
        Expectation(injection_gap_s=1.0),
    ),
    Scenario(
        "companion_clock_step",
        "The companion's clock jumps 1.5 s forward, and 20 s later 0.8 s back.",
        100.0,
        faults.jam(30.0) + faults.these(faults.CompanionClockStep(45.0, 1.5), faults.CompanionClockStep(65.0, -0.8)),
        Expectation(max_error_m=20.0, injection_gap_s=2.0),
    ),
    Scenario(
        "link_gaps",
        "Nothing passes the link for 1 s, 2 s and 4 s.",
        110.0,
        faults.jam(30.0) + faults.these(faults.LinkGap(45.0, 46.0), faults.LinkGap(60.0, 62.0), faults.LinkGap(75.0, 79.0)),
        Expectation(injection_gap_s=5.0, plane_max_error_m=SILENT_PLANE_M),
    ),
    Scenario(
        "worker_crash",
        "The localising process dies twice and needs 4 s to start again.",
        100.0,
        faults.jam(30.0) + faults.these(faults.WorkerCrash(45.0), faults.WorkerCrash(65.0)),
        Expectation(modes=(Mode.AIDING, Mode.DEAD_RECKONING, Mode.AIDING)),
    ),
)
