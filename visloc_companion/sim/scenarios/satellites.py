"""Flights in which satellite navigation goes wrong and everything else is well."""

from __future__ import annotations

import math

from visloc_companion.sim import faults
from visloc_companion.sim.scenarios.base import Expectation, Scenario, by_name
from visloc_companion.types import Mode, Vec3, Verdict

EAST: float = math.radians(90.0)
BAD_PLACE_NED_M: Vec3 = (60.0, -50.0, 0.0)
ANTENNA_NED_M: Vec3 = (-350.0, 260.0, -10.0)

SATELLITES: dict[str, Scenario] = by_name(
    Scenario("jam", "GNSS is jammed for good.", 120.0, faults.jam(30.0)),
    Scenario(
        "jam_on_and_off",
        "GNSS is jammed for 12 s, free for 8 s, and so on.",
        130.0,
        faults.intermittent(30.0, 12.0, 8.0, 130.0),
        Expectation(final_verdicts=(Verdict.DENIED, Verdict.SUSPECT), final_modes=(Mode.AIDING, Mode.DEAD_RECKONING)),
    ),
    Scenario("step_spoof", "GNSS jumps by 60 m and stays there.", 120.0, faults.step_spoof(30.0, (0.0, 60.0, 0.0))),
    Scenario(
        "slow_drag",
        "GNSS is dragged away at 1 m/s, position and velocity alike.",
        150.0,
        faults.slow_drag(30.0, 1.0, EAST),
        Expectation(verdict_within_s=30.0),
    ),
    Scenario(
        "meaconing",
        "GNSS is jammed for 10 s and then shows another antenna's place, 436 m from home, standing still.",
        120.0,
        faults.meaconed(30.0, 40.0, ANTENNA_NED_M),
    ),
    Scenario(
        "gnss_returns_bad",
        "GNSS is jammed for 40 s and comes back 78 m beside the truth.",
        150.0,
        faults.gnss_returns_bad(30.0, 70.0, BAD_PLACE_NED_M),
    ),
    Scenario(
        "gnss_returns_good",
        "GNSS is jammed for 40 s and comes back right: the autopilot is handed over to it again.",
        150.0,
        faults.jam(30.0, 70.0),
        Expectation(final_verdicts=(Verdict.OK,), modes=(Mode.AIDING, Mode.SHADOW), final_modes=(Mode.SHADOW,)),
    ),
    Scenario(
        "no_gnss",
        "There never was any GNSS; the operator says where the vehicle is, to 20 m.",
        110.0,
        faults.no_gnss(),
        Expectation(max_error_m=30.0),
        operator_fix_at_s=1.0,
    ),
)

DEMO = Scenario(
    "demo",
    "GNSS is dragged away at 1 m/s from 60 s and jammed from 120 s.",
    200.0,
    faults.slow_drag(60.0, 1.0, EAST, end_s=120.0, release_s=120.0) + faults.jam(120.0),
    Expectation(verdict_within_s=30.0),
)

LONG_JAM = Scenario(
    "long_jam",
    "GNSS is jammed for 18 minutes and comes back right.",
    1200.0,
    faults.jam(60.0, 1140.0),
    Expectation(final_verdicts=(Verdict.OK,), modes=(Mode.AIDING, Mode.SHADOW), final_modes=(Mode.SHADOW,)),
)
