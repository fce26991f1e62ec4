"""Closed-loop flights over a pack, flown in this process: set up, fly with and without the daemon's part, judge."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.app.localiser import configured_localiser
from visloc_companion.app.settings import core_settings
from visloc_companion.config import DEFAULT_METHOD, Config, InjectionConfig, LocaliserConfig, NavigatorConfig
from visloc_companion.core.navigator import Navigator
from visloc_companion.errors import MapError
from visloc_companion.evaluate.gate import Check
from visloc_companion.evaluate.metrics import Interval, error_figures, flight_summary
from visloc_companion.evaluate.record import FlightRecord, from_entries
from visloc_companion.geo.wgs84 import distance_m
from visloc_companion.localise.structure.localiser import METHOD as STRUCTURE
from visloc_companion.maps.pack import PackMap
from visloc_companion.sim.camera import SimulatedCamera
from visloc_companion.sim.flight import CLOCK_OFFSET_NS, ClosedLoopFlight, Eyes, FlightLog, OperatorEntry
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.render_effects import CameraEffects
from visloc_companion.sim.scenarios import Scenario
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.setup import FlightArea, FlightSetup
from visloc_companion.types import GeoPoint, Verdict

ALERT_LIMIT_M = 25.0
FRAME_RATE_HZ = 4.0
OPERATOR_SIGMA_M = 20.0
TICKS_AT_THE_END = 10
UNSEEN_PX = 3.0
"""A drag at 1 m/s needs so many seconds per metre of pixel size before it leaves the map's own error."""


@dataclass(frozen=True, slots=True, eq=False)
class FlightWorld:
    """The map that the navigator has, and the scene that its camera sees: another date of the same place."""

    pack: Path
    reference: PackMap
    scene: Scene

    def area(self) -> FlightArea:
        """Home on the map's surface in the middle, and how far map and scene reach around it."""
        easting, northing = self.reference.center_map_m
        lat, lon = self.reference.to_geo(easting, northing)
        height = self.reference.height_amsl_m(easting, northing)
        if not np.isfinite(height):
            raise MapError("has no surface height in its middle", where=str(self.pack), remedy="give a pack without a hole there")
        home = GeoPoint(lat, lon, float(height))
        return FlightArea(home, _reach_m(self.reference, home), self.reference.gsd_m)


@dataclass(frozen=True, slots=True, eq=False)
class FlownScenario:
    """A flight and what it showed."""

    setup: FlightSetup
    log: FlightLog
    record: FlightRecord
    summary: dict[str, Any]
    checks: list[Check]

    @property
    def passed(self) -> bool:
        """Whether all that the scenario expects came out."""
        return all(check.passed for check in self.checks)


def fly(
    setup: FlightSetup,
    world: FlightWorld,
    *,
    method: str = DEFAULT_METHOD,
    with_daemon: bool = True,
    on_progress: Callable[[float], None] | None = None,
) -> FlownScenario:
    """Fly one scenario in simulated time over a world. Raises MapError, ConfigError.

    Without the daemon only the autopilot flies, and nothing is expected.
    """
    return fly_with(setup, eyes_over(setup, world, method) if with_daemon else None, on_progress)


def fly_with(setup: FlightSetup, eyes: Eyes | None, on_progress: Callable[[float], None] | None = None) -> FlownScenario:
    """Fly one scenario with these eyes; with None nobody helps the autopilot, and nothing is expected."""
    pilot = setup.autopilot()
    if eyes is None:
        log = ClosedLoopFlight(pilot, None, None, None).run(setup.scenario.duration_s, on_progress)
        record = from_entries(log.entries, log.truth, t0_ns=CLOCK_OFFSET_NS)
        return FlownScenario(setup, log, record, flight_summary(record, alert_limit_m=ALERT_LIMIT_M), [])
    navigator = Navigator(core_settings(simulated_config(setup)))
    session, operator = MavlinkSession(SessionSettings()), _operator(setup.scenario)
    flight = ClosedLoopFlight(pilot, navigator, session, eyes, operator=operator)
    log = flight.run(setup.scenario.duration_s, on_progress)
    return judged(setup, log, from_entries(log.entries, log.truth, t0_ns=CLOCK_OFFSET_NS))


def eyes_over(setup: FlightSetup, world: FlightWorld, method: str) -> Eyes:
    """The rendering camera and the localiser of a name, on the network that came with this version.

    Raises ConfigError for a name that there is not, ModelError where the network cannot be used.
    """
    model = setup.camera_model()
    chosen = LocaliserConfig(threads=1, structure=setup.structure)
    chosen = chosen.model_copy(update={"method": method})  # unchecked: the registry refuses a wrong name
    localiser, _ = configured_localiser(chosen, model)
    camera = SimulatedCamera(CameraSimulator(world.scene, model, CameraEffects()), model, seed=setup.seed)
    return Eyes(camera, localiser, world.reference, FRAME_RATE_HZ)


def simulated_config(setup: FlightSetup) -> Config:
    """The configuration of the daemon on the simulated vehicle; it may switch the autopilot's source."""
    return Config(
        injection=InjectionConfig(switch_source=True),
        navigator=NavigatorConfig(map_sigma_m=map_sigma_m(setup.area.gsd_m)),
        localiser=LocaliserConfig(max_rate_hz=FRAME_RATE_HZ, structure=setup.structure),
        seed=setup.seed,
    )


def map_sigma_m(gsd_m: float) -> float:
    """1-sigma of a map's own registration where nobody measured it: half a pixel, at least half a metre."""
    return max(0.5, 0.5 * gsd_m)


def fault_intervals(scenario: Scenario) -> list[Interval]:
    """When GNSS is really bad, seconds since the start."""
    return [(scenario.fault_start_s, scenario.duration_s)] if np.isfinite(scenario.fault_start_s) else []


def judged(setup: FlightSetup, log: FlightLog, record: FlightRecord) -> FlownScenario:
    """The flight's figures and the checks that its scenario asks for."""
    summary = flight_summary(record, alert_limit_m=ALERT_LIMIT_M, gnss_faults_s=fault_intervals(setup.scenario))
    return FlownScenario(setup, log, record, summary, checks_of(setup.scenario, log, record, summary, setup.area.gsd_m))


def checks_of(scenario: Scenario, log: FlightLog, record: FlightRecord, summary: dict[str, Any], gsd_m: float) -> list[Check]:
    """What the scenario expects, each against what came out; limits on errors grow with pixels coarser than one metre."""
    expected = scenario.expected
    coarse = max(1.0, gsd_m)
    relied_on = (record.t_s >= scenario.fault_start_s) & record.injected
    error = error_figures(record, relied_on)
    detected, start_s = summary["gnss"]["detected_at_s"], scenario.fault_start_s
    delay = None if detected is None else detected - start_s
    gap_ms = summary["injected"]["gap_max_ms"]
    checks = [
        _at_most("median error without GNSS", error["median"], expected.median_error_m * coarse, "m"),
        _at_most("largest error without GNSS", error["max"], expected.max_error_m * coarse, "m"),
        _at_most("GNSS declared bad after", delay, expected.verdict_within_s + UNSEEN_PX * (coarse - 1.0), "s", "never"),
        _at_most("pulled by false GNSS", log.pulled_m, expected.pulled_m * coarse, "m"),
        _at_most("longest gap between injections", gap_ms, 1e3 * expected.injection_gap_s, "ms"),
        _at_most("false alarms", summary["gnss"]["false_alarms"], 0, ""),
        Check("failsafe", log.failsafe or "none", "none", log.failsafe is None),
        _verdict_at_the_end(record, expected.final_verdicts),
    ]
    return (
        checks if expected.structure_share == 0 else [*checks, _carried_by_structure(record, start_s, expected.structure_share)]
    )


def _at_most(name: str, value: float | None, limit: float, unit: str, missing: str = "none known") -> Check:
    shown = missing if value is None else f"{value:.3g} {unit}".strip()
    return Check(name, shown, f"≤ {limit:.3g} {unit}".strip(), value is not None and value <= limit)


def _verdict_at_the_end(record: FlightRecord, allowed: tuple[Verdict, ...]) -> Check:
    seen = set(record.verdicts[-TICKS_AT_THE_END:])
    passed = bool(seen) and seen <= set(allowed)
    return Check("verdict at the end", ", ".join(sorted(seen)) or "none", " or ".join(allowed), passed)


def _carried_by_structure(record: FlightRecord, start_s: float, least: float) -> Check:
    methods = [fix.method for fix in record.fixes if fix.t_s >= start_s]
    share = methods.count(STRUCTURE) / len(methods) if methods else 0.0
    shown = f"{share:.0%} of {len(methods)}"
    return Check("fixes by structure without GNSS", shown, f"≥ {least:.0%}", share >= least)


def _operator(scenario: Scenario) -> OperatorEntry | None:
    at_s = scenario.operator_fix_at_s
    error_ned_m = (0.6 * OPERATOR_SIGMA_M, -0.5 * OPERATOR_SIGMA_M, 0.0)
    return None if at_s is None else OperatorEntry(at_s, error_ned_m, OPERATOR_SIGMA_M)


def _reach_m(reference: PackMap, home: GeoPoint) -> float:
    rows, cols = reference.shape
    corners = np.array([[0, 0], [cols - 1, 0], [0, rows - 1], [cols - 1, rows - 1]], dtype=np.float64)
    T = reference.T_map_pix
    map_m = corners @ T[:, :2].T + T[:, 2]
    places = [GeoPoint(*reference.to_geo(float(e), float(n)), home.h_amsl_m) for e, n in map_m]
    north_m = min(abs(distance_m(GeoPoint(p.lat_deg, home.lon_deg, 0.0), home)) for p in places)
    east_m = min(abs(distance_m(GeoPoint(home.lat_deg, p.lon_deg, 0.0), home)) for p in places)
    return min(north_m, east_m)
