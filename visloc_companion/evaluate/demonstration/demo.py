"""The demonstration: the built-in autopilot as a process of its own, the real daemon with its worker, one flight, one report."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from visloc_companion.app.journal import read_journal
from visloc_companion.config import DEFAULT_METHOD
from visloc_companion.errors import ConfigError
from visloc_companion.evaluate.campaign import result_of
from visloc_companion.evaluate.closed_loop import ALERT_LIMIT_M, FlightWorld, FlownScenario, fault_intervals, fly, judged
from visloc_companion.evaluate.demonstration.core_waits import CoreWaits, load_waits
from visloc_companion.evaluate.demonstration.demo_processes import WAITS, Stage, fly_processes, journal_of, require_ours
from visloc_companion.evaluate.demonstration.free_cores import affordable_speed, free_cores, slower
from visloc_companion.evaluate.gate import Check
from visloc_companion.evaluate.map_image import map_image
from visloc_companion.evaluate.record import from_entries
from visloc_companion.evaluate.report import write_flight_report
from visloc_companion.localise.registry import open_features_for
from visloc_companion.localise.runtime import NetworkChoice
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.world import procedural_world
from visloc_companion.sim.scenarios import DEMO
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.setup import FlightSetup
from visloc_companion.types import AutopilotKind

FULL_SPEED = 2.0
BASELINE_OFF_M = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class DemoResult:
    """What the demonstration showed, and where it lies."""

    flown: FlownScenario
    baseline_off_m: float
    report: Path
    waits: CoreWaits | None
    """Of the flight's processes for a core; None where the kernel does not tell."""

    @property
    def passed(self) -> bool:
        """Whether every requirement was met."""
        return self.flown.passed

    def as_json(self) -> dict[str, Any]:
        """The result as `visloc sim` states it, and how far off the flight without the daemon ended."""
        extra = {
            "off_without_daemon_m": round(self.baseline_off_m, 3),
            "report": str(self.report),
            "computer": None if self.waits is None else asdict(self.waits),
        }
        return result_of(self.flown, DEFAULT_METHOD) | extra


def run_demo(out: Path, dialect: AutopilotKind, speed: float | None, on_stage: Stage) -> DemoResult:
    """Make the world, fly with the daemon and without, judge, and write `out/report.html`.

    `speed`: times real time; None for FULL_SPEED, or less where other work leaves less of the computer, or its cores are slow.

    Raises LinkError where one of the processes ended early, with the end of its log, ConfigError where `out` cannot be made or
    holds what another than the demonstration left there, ConfigError or ModelError before anything is made where the
    localiser's network cannot be used.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as why:
        raise ConfigError(f"cannot be made: {why}", where=str(out), remedy="name a writable folder for --out") from why
    require_ours(out)
    network = open_features_for(DEFAULT_METHOD, NetworkChoice(threads=len(os.sched_getaffinity(0))))
    world_files = procedural_world(1, on_stage=on_stage, networks=[network] if network else None)
    reference = PackMap.open(world_files.pack, verify_hashes=True)
    scene = Scene.load(world_files.flight_ortho, world_files.flight_dsm)
    world = FlightWorld(world_files.pack, reference, scene)
    setup = FlightSetup(DEMO, world.area(), dialect, "copter", 1)
    on_stage("flying without the daemon")
    baseline = fly(setup, world, with_daemon=False)
    del scene
    log = fly_processes(out, setup, world_files, _affordable(on_stage) if speed is None else speed, on_stage)
    record = from_entries(read_journal(journal_of(out)), log.truth, t0_ns=log.truth[0].t_ns)
    off_m = baseline.log.truth[-1].off_m or 0.0
    flown = judged(setup, log, record)
    flown.checks.append(
        Check("autopilot off without the daemon", f"{off_m:.0f} m", f"> {BASELINE_OFF_M:.0f} m", off_m > BASELINE_OFF_M)
    )
    on_stage("writing the report")
    report = out / "report.html"
    title = f"GNSS loss over the procedural world, {dialect.value} copter"
    write_flight_report(
        record,
        report,
        title=title,
        checks=flown.checks,
        baseline=baseline.record,
        map_image=map_image(reference, record, baseline.record),
        alert_limit_m=ALERT_LIMIT_M,
        gnss_faults_s=fault_intervals(setup.scenario),
    )
    return DemoResult(flown, off_m, report, load_waits(out / WAITS))


def _affordable(on_stage: Stage) -> float:
    cores, longer = free_cores(), slower()
    speed = affordable_speed(FULL_SPEED, cores, longer)
    if speed < FULL_SPEED:
        on_stage(f"{cores:.1f} cores are free, each needs {longer:.1f} times as long as usual: the flight goes slower")
    return speed
