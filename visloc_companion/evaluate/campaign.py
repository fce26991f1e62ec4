"""Flights by description: what `visloc sim` flies, one or many, and the totals of a campaign (evaluation.md section 3.6)."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, get_args

import numpy as np

from visloc_companion.errors import ConfigError
from visloc_companion.evaluate.closed_loop import FlightWorld, FlownScenario, fly
from visloc_companion.maps.pack import PackMap
from visloc_companion.sim.scenarios import DEMO, SCENARIOS, Scenario
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.setup import FlightSetup, VehicleKind
from visloc_companion.types import AutopilotKind

CAMPAIGNS = {
    "scenarios": (("ardupilot", "px4"), ("copter",), (1,)),
    "vehicles": (("ardupilot", "px4"), ("copter", "plane"), (1, 2)),
}
"""Name -> dialects, vehicles and seeds; each with every scenario."""


@dataclass(frozen=True, slots=True)
class FlightSpec:
    """One flight to fly. Paths are those of a pack and of what the camera sees."""

    scenario: str
    pack: Path
    camera_ortho: Path
    camera_dsm: Path | None
    dialect: str = "ardupilot"
    vehicle: str = "copter"
    seed: int = 1
    method: str = "gradient"
    with_daemon: bool = True


def find_scenario(name: str) -> Scenario:
    """The scenario of a name. Raises ConfigError that lists the names."""
    if name == DEMO.name:
        return DEMO
    if name not in SCENARIOS:
        raise ConfigError(f"unknown scenario {name!r}", remedy=f"one of {', '.join([*SCENARIOS, DEMO.name])}")
    return SCENARIOS[name]


def fly_spec(spec: FlightSpec, on_progress: Callable[[float], None] | None = None) -> FlownScenario:
    """Open the files and fly. Raises ConfigError, MapError."""
    if spec.vehicle not in get_args(VehicleKind):
        raise ConfigError(f"unknown vehicle {spec.vehicle!r}", remedy="copter or plane")
    scenario = find_scenario(spec.scenario)
    reference = PackMap.open(spec.pack, verify_hashes=False)
    easting, northing = reference.center_map_m
    ground = float(np.nan_to_num(reference.height_amsl_m(easting, northing)))
    world = FlightWorld(spec.pack, reference, Scene.load(spec.camera_ortho, spec.camera_dsm, ground))
    vehicle: VehicleKind = "plane" if spec.vehicle == "plane" else "copter"
    setup = FlightSetup(scenario, world.area(), AutopilotKind(spec.dialect), vehicle, spec.seed)
    return fly(setup, world, method=spec.method, with_daemon=spec.with_daemon, on_progress=on_progress)


def result_of(spec: FlightSpec, flown: FlownScenario) -> dict[str, Any]:
    """The JSON of one flight."""
    expected = [{"name": c.name, "value": c.value, "limit": c.limit, "passed": c.passed} for c in flown.checks]
    return {
        **flown.summary,
        "scenario": spec.scenario,
        "autopilot": "built-in",
        "dialect": spec.dialect,
        "vehicle": spec.vehicle,
        "seed": spec.seed,
        "method": spec.method,
        "with_daemon": spec.with_daemon,
        "failsafe": flown.log.failsafe,
        "pulled_m": round(flown.log.pulled_m, 3),
        "modes": flown.record.changes(flown.record.modes),
        "verdicts": flown.record.changes(flown.record.verdicts),
        "passed": flown.passed,
        "expected": expected,
    }


def campaign_specs(name: str, template: FlightSpec) -> list[FlightSpec]:
    """The flights of a named campaign, or of a JSON file with a list of objects {scenario, dialect, vehicle, seed, method}.

    Raises ConfigError naming the file and the entry.
    """
    if name in CAMPAIGNS:
        dialects, vehicles, seeds = CAMPAIGNS[name]
        return [
            replace(template, scenario=scenario, dialect=dialect, vehicle=vehicle, seed=seed)
            for scenario in SCENARIOS
            for dialect in dialects
            for vehicle in vehicles
            for seed in seeds
        ]
    return list(_specs_of_file(Path(name), template))


def _specs_of_file(path: Path, template: FlightSpec) -> Iterator[FlightSpec]:
    remedy = f"name one of {', '.join(CAMPAIGNS)} or a JSON file with a list of flights"
    try:
        items = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as why:
        raise ConfigError(f"is no campaign: {why}", where=str(path), remedy=remedy) from why
    if not isinstance(items, list) or not items:
        raise ConfigError("holds no list of flights", where=str(path), remedy=remedy)
    allowed = {"scenario", "dialect", "vehicle", "seed", "method", "with_daemon"}
    for k, item in enumerate(items):
        if not isinstance(item, dict) or not set(item) <= allowed or "scenario" not in item:
            raise ConfigError(
                f"entry {k} needs scenario and may have {', '.join(sorted(allowed))}", where=str(path), remedy=remedy
            )
        find_scenario(item["scenario"])
        yield replace(template, **item)


def run_campaign(specs: list[FlightSpec], jobs: int, on_flight: Callable[[dict[str, Any]], None]) -> dict[str, Any]:
    """Fly all, some at a time, and add the totals up."""
    with ProcessPoolExecutor(max(1, jobs), mp_context=get_context("spawn")) as pool:
        flown = []
        for one in pool.map(_fly_one, specs):
            on_flight(one[0])
            flown.append(one)
    results = [result for result, _, _ in flown]
    levels = np.concatenate([level for _, level, _ in flown])
    errors = np.concatenate([error for _, _, error in flown])
    shares = [result["availability"] for result in results if result["availability"] is not None]
    totals = {
        "flights": len(results),
        "passed": sum(result["passed"] for result in results),
        "fix_epochs": sum(result["n_fixes"] for result in results),
        "hmi": sum(result["hmi"] or 0 for result in results),
        "availability": round(float(np.mean(shares)), 4) if shares else None,
        "protection_level_median_m": _median(levels),
        "error_median_m": _median(errors),
    }
    return {"schema": 1, "flights": results, "totals": totals}


def _fly_one(spec: FlightSpec) -> tuple[dict[str, Any], Any, Any]:
    flown = fly_spec(spec)
    return result_of(spec, flown), flown.record.protection_level_m, flown.record.error_m


def _median(values: Any) -> float | None:
    finite = values[np.isfinite(values)]
    return round(float(np.median(finite)), 3) if len(finite) else None
