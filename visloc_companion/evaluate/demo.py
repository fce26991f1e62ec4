"""The demonstration: the built-in autopilot as a process of its own, the real daemon with its worker, one flight, one report."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from visloc_companion.app.journal import read_journal
from visloc_companion.app.status import check_status_socket
from visloc_companion.config import DEFAULT_METHOD
from visloc_companion.errors import ConfigError, LinkError
from visloc_companion.evaluate.campaign import result_of
from visloc_companion.evaluate.closed_loop import ALERT_LIMIT_M, FlightWorld, FlownScenario, fault_intervals, fly, judged
from visloc_companion.evaluate.ended_in_order import ended_in_order
from visloc_companion.evaluate.free_cores import affordable_speed, free_cores
from visloc_companion.evaluate.gate import Check
from visloc_companion.evaluate.map_image import map_image
from visloc_companion.evaluate.record import from_entries
from visloc_companion.evaluate.report import write_flight_report
from visloc_companion.localise.registry import open_features_for
from visloc_companion.localise.runtime import NetworkChoice
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.world import ProceduralWorld, procedural_world
from visloc_companion.sim.flight import FlightLog, TruthSample
from visloc_companion.sim.scenarios import DEMO
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.server import ServerPlan
from visloc_companion.sim.setup import FlightSetup
from visloc_companion.types import AutopilotKind, GeoPoint

FRAME_RATE_HZ = 2.5
FULL_SPEED = 2.0
BASELINE_OFF_M = 100.0
STARTUP_S = 60.0
SHUTDOWN_S = 15.0

OURS = "# Written by the demonstration"

Stage = Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class DemoResult:
    """What the demonstration showed, and where it lies."""

    flown: FlownScenario
    baseline_off_m: float
    report: Path

    @property
    def passed(self) -> bool:
        """Whether every requirement was met."""
        return self.flown.passed

    def as_json(self) -> dict[str, Any]:
        """The result as `visloc sim` states it, and how far off the flight without the daemon ended."""
        extra = {"off_without_daemon_m": round(self.baseline_off_m, 3), "report": str(self.report)}
        return result_of(self.flown, DEFAULT_METHOD) | extra


def run_demo(out: Path, dialect: AutopilotKind, speed: float | None, on_stage: Stage) -> DemoResult:
    """Make the world, fly with the daemon and without, judge, and write `out/report.html`.

    `speed`: times real time; None for FULL_SPEED, or less where other work leaves less of the computer.

    Raises LinkError where one of the processes ended early, with the end of its log, ConfigError where `out` cannot be made or
    holds what another than the demonstration left there, ConfigError or ModelError before anything is made where the
    localiser's network cannot be used.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as why:
        raise ConfigError(f"cannot be made: {why}", where=str(out), remedy="name a writable folder for --out") from why
    _require_ours(out)
    network = open_features_for(DEFAULT_METHOD, NetworkChoice(threads=len(os.sched_getaffinity(0))))
    world_files = procedural_world(1, on_stage=on_stage, networks=[network] if network else None)
    reference = PackMap.open(world_files.pack, verify_hashes=True)
    scene = Scene.load(world_files.flight_ortho, world_files.flight_dsm)
    world = FlightWorld(world_files.pack, reference, scene)
    setup = FlightSetup(DEMO, world.area(), dialect, "copter", 1)
    on_stage("flying without the daemon")
    baseline = fly(setup, world, with_daemon=False)
    del scene
    log = _fly_processes(out, setup, world_files, _affordable(on_stage) if speed is None else speed, on_stage)
    record = from_entries(read_journal(_journal(out)), log.truth, t0_ns=log.truth[0].t_ns)
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
    return DemoResult(flown, off_m, report)


def _require_ours(out: Path) -> None:
    """A demonstration replaces its own files of before; nobody else's journals and configurations."""
    config = out / "visloc.toml"
    if config.is_file() and config.read_text(encoding="utf-8", errors="replace").startswith(OURS):
        return
    others = [path.name for path in (*out.glob("*.mcap"), config) if path.exists()]
    if others:
        raise ConfigError(
            f"holds {', '.join(sorted(others)[:3])}, which no demonstration wrote",
            where=str(out),
            remedy="name a new folder for --out: the demonstration's journal and configuration would take their place",
        )


def _affordable(on_stage: Stage) -> float:
    cores = free_cores()
    speed = affordable_speed(FULL_SPEED, cores)
    if speed < FULL_SPEED:
        on_stage(f"other work leaves {cores:.1f} cores: the flight goes slower")
    return speed


def _fly_processes(out: Path, setup: FlightSetup, world: ProceduralWorld, speed: float, on_stage: Stage) -> FlightLog:
    plan = _plan(out, setup, world, speed)
    plan.save(out / "plan.json")
    config = out / "visloc.toml"
    status_socket = _status_socket(out)
    config.write_text(_config_text(setup, plan, world, status_socket), encoding="utf-8")
    for old in out.glob("*.mcap"):
        old.unlink()
    flown = f"flying {setup.scenario.duration_s:.0f} s at {speed:.2g} times real time, daemon and autopilot over UDP"
    on_stage(f"{flown}; to watch: visloc web --config {config}" if status_socket else flown)
    with (
        ended_in_order(),
        (out / "autopilot.log").open("wb") as pilot_log,
        (out / "daemon.log").open("wb") as daemon_log,
    ):
        pilot = subprocess.Popen([sys.executable, "-m", "visloc_companion.sim.server", str(out / "plan.json")], stderr=pilot_log)
        daemon = subprocess.Popen(
            [sys.executable, "-m", "visloc_companion.cli.main", "run", "--config", str(config)],
            stderr=daemon_log,
            stdout=daemon_log,
        )
        try:
            _wait(pilot, daemon, out, setup.scenario.duration_s / speed)
        finally:
            _stop(daemon)
            _stop(pilot)
    return _log_of(json.loads(Path(plan.result).read_text(encoding="utf-8")), setup.scenario.duration_s)


def _wait(pilot: subprocess.Popen[bytes], daemon: subprocess.Popen[bytes], out: Path, flight_s: float) -> None:
    end = time.monotonic() + flight_s + STARTUP_S
    while (code := pilot.poll()) is None:
        if daemon.poll() is not None:
            raise LinkError(f"the daemon ended early: {_tail(out / 'daemon.log')}", where=str(out / "daemon.log"))
        if time.monotonic() > end:
            raise LinkError("the simulated flight did not end in time", where=str(out / "autopilot.log"))
        time.sleep(0.2)
    if code != 0:
        raise LinkError(f"the autopilot ended early: {_tail(out / 'autopilot.log')}", where=str(out / "autopilot.log"))


def _stop(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(SHUTDOWN_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _plan(out: Path, setup: FlightSetup, world: ProceduralWorld, speed: float) -> ServerPlan:
    area = setup.area
    mavlink_port, camera_port = _free_port(socket.SOCK_DGRAM), _free_port(socket.SOCK_STREAM)
    return ServerPlan(
        setup.scenario.name,
        setup.kind,
        setup.vehicle,
        setup.seed,
        speed,
        mavlink_port,
        camera_port,
        FRAME_RATE_HZ,
        str(world.flight_ortho),
        str(world.flight_dsm),
        area.home,
        area.reach_m,
        area.gsd_m,
        area.turn_rad,
        str(out / "truth.json"),
    )


def _config_text(setup: FlightSetup, plan: ServerPlan, world: ProceduralWorld, status_socket: str) -> str:
    model = setup.camera_model()
    return f"""{OURS}: the daemon beside the built-in autopilot.
seed = {setup.seed}

[link]
url = "udpin:127.0.0.1:{plan.mavlink_port}"

[camera]
url = "tcp:127.0.0.1:{plan.camera_port}"
width_px = {model.width_px}
height_px = {model.height_px}
fx_px = {model.fx_px!r}
fy_px = {model.fy_px!r}
cx_px = {model.cx_px}
cy_px = {model.cy_px}

[map]
pack = {json.dumps(str(world.pack))}

[localiser]
method = "{DEFAULT_METHOD}"
max_rate_hz = {plan.frame_rate_hz}

[worker]
nice = 0

[injection]
switch_source = true

[journal]
folder = {json.dumps(str(Path(plan.result).parent))}

[status]
socket = {json.dumps(status_socket)}

[clock]
speed = {plan.speed}
"""


def _status_socket(out: Path) -> str:
    """Where the dashboard may ask; empty where no socket can be: too long a path, or a file system that has none."""
    path = out / "status.sock"
    try:
        check_status_socket(path)
    except ConfigError:
        return ""
    return str(path)


def _free_port(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _journal(out: Path) -> Path:
    found = sorted(out.glob("*.mcap"))
    if not found:
        raise LinkError("the daemon wrote no journal", where=str(out), remedy=f"see {out / 'daemon.log'}")
    return found[-1]


def _log_of(result: dict[str, Any], duration_s: float) -> FlightLog:
    truth = [TruthSample(int(t_ns), GeoPoint(lat, lon, h), None) for t_ns, lat, lon, h in result["truth"]]
    return FlightLog([], truth, result["failsafe"], float(result["pulled_m"]), duration_s)


def _tail(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace")[-1500:].strip()
