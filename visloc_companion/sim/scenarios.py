"""The library of flights: what goes wrong, when, and what must come out. Times are seconds since the start of the flight."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from visloc_companion.sim import faults
from visloc_companion.sim.faults import FaultSchedule
from visloc_companion.sim.season import Date
from visloc_companion.types import Vec3, Verdict


@dataclass(frozen=True, slots=True)
class Expectation:
    """Limits on what a flight with the daemon must show.

    Errors are those of the navigator's position against truth while GNSS is denied or spoofed and positions are injected
    (without any GNSS the first of them are the operator's). `verdict_within_s` counts from the first fault of GNSS;
    `final_verdicts` are allowed in the last second. At least `structure_share` of the fixes of that time are the structure's.
    """

    median_error_m: float = 2.0
    max_error_m: float = 10.0
    verdict_within_s: float = 5.0
    pulled_m: float = 30.0
    injection_gap_s: float = 0.2
    final_verdicts: tuple[Verdict, ...] = (Verdict.DENIED, Verdict.SUSPECT)
    structure_share: float = 0.0


@dataclass(frozen=True, slots=True)
class Scenario:
    """A flight: its faults, its length, what is expected of it, and the date on which the procedural world is seen."""

    name: str
    summary: str
    duration_s: float
    faults: FaultSchedule
    expected: Expectation = field(default_factory=Expectation)
    operator_fix_at_s: float | None = None
    date: Date = "flight"

    @property
    def fault_start_s(self) -> float:
        """When GNSS first goes wrong, 0 for a flight that never had it, infinity for one that always has it."""
        start = self.faults.gnss_start_s
        return math.inf if start is None else max(start, 0.0)


EAST: float = math.radians(90.0)
BAD_PLACE_NED_M: Vec3 = (60.0, -50.0, 0.0)

SCENARIOS: dict[str, Scenario] = {
    s.name: s
    for s in (
        Scenario("jam", "GNSS is jammed for good.", 120.0, faults.jam(30.0)),
        Scenario(
            "step_spoof",
            "GNSS jumps by 60 m and stays there.",
            120.0,
            faults.step_spoof(30.0, (0.0, 60.0, 0.0)),
        ),
        Scenario(
            "slow_drag",
            "GNSS is dragged away at 1 m/s, position and velocity alike.",
            150.0,
            faults.slow_drag(30.0, 1.0, EAST),
            Expectation(verdict_within_s=30.0),
        ),
        Scenario(
            "gnss_returns_bad",
            "GNSS is jammed for 40 s and comes back 78 m beside the truth.",
            150.0,
            faults.gnss_returns_bad(30.0, 70.0, BAD_PLACE_NED_M),
        ),
        Scenario(
            "camera_freeze",
            "GNSS is jammed, and for 12 s the camera repeats one picture.",
            130.0,
            faults.jam(30.0) + faults.camera_freeze(60.0, 72.0),
            Expectation(max_error_m=20.0),
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
}

DEMO = Scenario(
    "demo",
    "GNSS is dragged away at 1 m/s from 60 s and jammed from 120 s.",
    200.0,
    faults.slow_drag(60.0, 1.0, EAST, end_s=120.0, release_s=120.0) + faults.jam(120.0),
    Expectation(verdict_within_s=30.0),
)

SEASON_CHANGE = Scenario(
    "season_change",
    "GNSS is jammed for good over deep snow; the map is of a summer.",
    150.0,
    faults.jam(30.0),
    Expectation(median_error_m=3.0, max_error_m=15.0, structure_share=0.2),
    date="snow",
)

FLIGHTS: dict[str, Scenario] = {**SCENARIOS, DEMO.name: DEMO, SEASON_CHANGE.name: SEASON_CHANGE}
"""All by name. The last two are no part of campaigns: one is the demonstration, one needs a world under snow."""
