"""Flights by description: what `visloc sim` flies, one or many, and the totals of a campaign (docs/simulation.md)."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, replace
from itertools import islice
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np

from visloc_companion.app.with_parent import end_with_parent
from visloc_companion.config import DEFAULT_METHOD
from visloc_companion.errors import ConfigError, WorkerError, did_you_mean
from visloc_companion.evaluate.closed_loop import FlightWorld, FlownScenario, fly
from visloc_companion.evaluate.ended_in_order import aside
from visloc_companion.evaluate.keys_once import loads_keys_once
from visloc_companion.evaluate.sim_journal import JournalChoice
from visloc_companion.localise.registry import METHODS
from visloc_companion.maps.pack import PackMap
from visloc_companion.sim.scenarios import FLIGHTS, SCENARIOS, Scenario
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.setup import FlightSetup, VehicleKind
from visloc_companion.sim.vehicles.gimbal import GimbalPlan
from visloc_companion.types import AutopilotKind, FloatArray

CAMPAIGNS = {
    "scenarios": (("ardupilot", "px4"), ("copter",), (1,)),
    "vehicles": (("ardupilot", "px4"), ("copter", "plane"), (1, 2)),
}
"""Name -> dialects, vehicles and seeds; each with every scenario."""
DIALECTS = ("ardupilot", "px4")
VEHICLES: tuple[VehicleKind, ...] = get_args(VehicleKind)
OF_A_FLIGHT = ("scenario", "dialect", "vehicle", "seed", "method", "with_daemon", "structure", "gimbal")
"""What a flight of a campaign's file may say."""
LOOK_EVERY_S = 0.2
"""How often a campaign looks whether it was told to end."""
_SAID_ELSEWHERE = {
    "autopilot": "flights of a file have the built-in one, and 'dialect' says whose behaviour it has",
    "map": "--map is that of all flights",
    "camera_ortho": "--camera-ortho is that of all flights",
    "camera_dsm": "--camera-dsm is that of all flights",
    "without_daemon": 'write "with_daemon": false',
    "without_structure": 'write "structure": false',
    "jobs": "--jobs is that of all flights",
}
"""Options of `visloc sim` that are no keys of a flight, and how to say the same."""


@dataclass(frozen=True, slots=True)
class FlightSpec:
    """One flight to fly. Paths are those of a pack and of what the camera sees. Raises ConfigError for a name that is none."""

    scenario: str
    pack: Path
    camera_ortho: Path | None
    """None: the pack's own. Camera and map are the same image then, and the result says so."""
    camera_dsm: Path | None
    dialect: str = "ardupilot"
    vehicle: str = "copter"
    seed: int = 1
    method: str = DEFAULT_METHOD
    with_daemon: bool = True
    height_m: float | None = None
    """Above home; None: what suits the map's pixels."""
    structure: bool = True
    """Whether the structure vote is asked for where the image fails."""
    gimbal: bool = False
    """Whether a gimbal that points straight down carries the camera, where the scenario has none of its own."""

    def __post_init__(self) -> None:
        kinds = {"seed": int, "with_daemon": bool, "structure": bool, "gimbal": bool}
        for item in OF_A_FLIGHT:
            value, kind = getattr(self, item), kinds.get(item, str)
            if type(value) is not kind:
                raise ConfigError(f"{item} is {value!r}, no {kind.__name__}", remedy="see visloc sim --help")
        if self.seed < 0:
            raise ConfigError(f"seed is {self.seed}", remedy="give a whole number from 0 on")
        find_scenario(self.scenario)
        _one_of("dialect", self.dialect, DIALECTS)
        _one_of("vehicle", self.vehicle, VEHICLES)
        _one_of("method", self.method, METHODS)


def _one_of(what: str, name: str, known: Sequence[str]) -> None:
    if name not in known:
        near = did_you_mean(name, known)
        raise ConfigError(f"unknown {what} {name!r}" + (f" ({near})" if near else ""), remedy=f"one of {', '.join(known)}")


def find_scenario(name: str) -> Scenario:
    """The scenario of a name. Raises ConfigError that lists the names."""
    _one_of("scenario", name, list(FLIGHTS))
    return FLIGHTS[name]


def fly_spec(
    spec: FlightSpec, on_progress: Callable[[float], None] | None = None, kept: JournalChoice | None = None
) -> FlownScenario:
    """Open the files and fly; `kept`: the journal to write. Without a surface model of its own the camera's scene has the pack's.

    Raises MapError, and JournalError where the journal cannot be written.
    """
    reference = PackMap.open(spec.pack, verify_hashes=False)
    easting, northing = reference.center_map_m
    ground = float(np.nan_to_num(reference.height_amsl_m(easting, northing)))
    surface = reference.manifest.heights.grid
    dsm = spec.camera_dsm or (None if surface is None else spec.pack / surface.file)
    ortho = spec.camera_ortho or spec.pack / reference.manifest.ortho.file
    world = FlightWorld(spec.pack, reference, Scene.load(ortho, dsm, ground))
    vehicle = cast("VehicleKind", spec.vehicle)
    scenario, kind = find_scenario(spec.scenario), AutopilotKind(spec.dialect)
    if spec.gimbal and scenario.gimbal is None:
        scenario = replace(scenario, gimbal=GimbalPlan())
    setup = FlightSetup(scenario, world.area(), kind, vehicle, spec.seed, spec.height_m, spec.structure)
    return fly(setup, world, method=spec.method, with_daemon=spec.with_daemon, on_progress=on_progress, kept=kept)


def result_of(flown: FlownScenario, method: str, with_daemon: bool = True, same_image: bool = False) -> dict[str, Any]:
    """The JSON of one flight: the figures of the summary, what was flown, and what was expected."""
    setup, log, record = flown.setup, flown.log, flown.record
    return {
        **flown.summary,
        "scenario": setup.scenario.name,
        "autopilot": "built-in",
        "dialect": setup.kind.value,
        "vehicle": setup.vehicle,
        "seed": setup.seed,
        "method": method,
        "with_daemon": with_daemon,
        "same_image": same_image,
        "structure": setup.structure,
        "gimbal": setup.scenario.gimbal is not None,
        "fixes_by_method": dict(sorted(Counter(fix.method for fix in record.fixes).items())),
        "failsafe": log.failsafe,
        "pulled_m": round(log.pulled_m, 3),
        "modes": record.changes(record.modes),
        "verdicts": record.changes(record.verdicts),
        "judged": bool(flown.checks),
        "passed": flown.passed,
        "expected": [asdict(check) for check in flown.checks],
    }


def campaign_specs(name: str, template: FlightSpec) -> list[FlightSpec]:
    """The flights of a named campaign, or of a JSON file: a list of objects with a scenario and what else is `OF_A_FLIGHT`.

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
        items = loads_keys_once(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError) as why:
        raise ConfigError(f"is no campaign: {why}", where=str(path), remedy=remedy) from why
    if not isinstance(items, list) or not items:
        raise ConfigError("holds no list of flights", where=str(path), remedy=remedy)
    for k, item in enumerate(items):
        said, what_to_do = _wrong_with(item)
        if said:
            needed = f"entry {k} needs scenario and may have {', '.join(sorted(OF_A_FLIGHT))}"
            raise ConfigError(f"{needed}: {said}", where=str(path), remedy=what_to_do)
        try:
            yield replace(template, **item)
        except ConfigError as why:
            raise ConfigError(f"entry {k}: {why.what}", where=str(path), remedy=why.remedy) from why


def _wrong_with(item: object) -> tuple[str, str]:
    """What makes an entry no flight and what to do about it; empty where nothing does."""
    if not isinstance(item, dict):
        return f"it is {item!r:.40}, no object", 'write {"scenario": NAME} for each flight'
    unknown = sorted(set(item) - set(OF_A_FLIGHT))
    if unknown:
        near = {name: _SAID_ELSEWHERE.get(name) or did_you_mean(name, OF_A_FLIGHT) for name in unknown}
        told = ", ".join(f"{name!r}" + (f" ({near[name]})" if near[name] else "") for name in unknown)
        return f"unknown {told}", "correct the key, or leave it out"
    return ("", "") if "scenario" in item else ("it names none", "add scenario, one of visloc sim --list")


@dataclass(frozen=True, slots=True, eq=False)
class FlownSpec:
    """The result of the flight `number` of a campaign (`result_of`), and at each epoch (n,) its protection level and error, m."""

    number: int
    result: dict[str, Any]
    protection_level_m: FloatArray
    error_m: FloatArray


def fly_campaign(specs: Sequence[FlightSpec], jobs: int) -> Generator[FlownSpec, None, None]:
    """Fly all, `jobs` at a time in processes of their own; each as it ends.

    What a flight raises ends the campaign, and so does closing the generator: flights under way end with it, as they do where
    this process is killed. Raises WorkerError where the process of a flight is killed.
    """
    told_to_end = threading.Event()
    return aside(lambda: _flown(specs, max(1, jobs), told_to_end), told_to_end.set)


def _flown(specs: Sequence[FlightSpec], jobs: int, told_to_end: threading.Event) -> Iterator[FlownSpec]:
    others = active_children()
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=end_with_parent)
    waiting, flying = enumerate(specs), set[Future[FlownSpec]]()
    try:
        while not told_to_end.is_set():
            # no more than fly: a process that is interrupted would begin with what the pool has queued
            flying |= {pool.submit(_fly_one, number, spec) for number, spec in islice(waiting, jobs - len(flying))}
            if not flying:
                return
            ended, flying = wait(flying, LOOK_EVERY_S, return_when=FIRST_COMPLETED)
            for flight in sorted(ended, key=lambda one: one.exception() is not None):
                yield flight.result()
    except BrokenProcessPool as why:
        raise WorkerError("the process of a flight was killed", remedy="where memory ran out: fewer --jobs") from why
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in active_children():
            if process not in others:
                process.terminate()  # the pool would wait for its flight's end


def campaign_outcome(flown: Sequence[FlownSpec], n_asked: int) -> dict[str, Any]:
    """The JSON of a campaign: its flights in the order asked for, and their totals. `complete`: all of them were flown."""
    flown = sorted(flown, key=lambda one: one.number)
    results = [one.result for one in flown]
    shares = [result["availability"] for result in results if result["availability"] is not None]
    totals = {
        "flights": len(results),
        "passed": sum(result["passed"] for result in results),
        "judged": sum(result["judged"] for result in results),
        "fix_epochs": sum(result["n_fixes"] for result in results),
        "hmi": sum(result["hmi"] or 0 for result in results),
        "availability": round(float(np.mean(shares)), 4) if shares else None,
        "protection_level_median_m": _median([one.protection_level_m for one in flown]),
        "error_median_m": _median([one.error_m for one in flown]),
    }
    return {"schema": 1, "complete": len(flown) == n_asked, "asked": n_asked, "flights": results, "totals": totals}


def _fly_one(number: int, spec: FlightSpec) -> FlownSpec:
    flown = fly_spec(spec)
    result = result_of(flown, spec.method, spec.with_daemon, spec.camera_ortho is None)
    return FlownSpec(number, result, flown.record.protection_level_m, flown.record.error_m)


def _median(flights: list[FloatArray]) -> float | None:
    values = np.concatenate(flights) if flights else np.empty(0)
    finite = values[np.isfinite(values)]
    return round(float(np.median(finite)), 3) if len(finite) else None
