"""The built-in autopilot and the real daemon as processes of their own: what each is told, and what becomes of their ends."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from visloc_companion.app.status import check_status_socket
from visloc_companion.app.with_parent import end_with_starter
from visloc_companion.config import DEFAULT_METHOD
from visloc_companion.errors import ConfigError, LinkError
from visloc_companion.evaluate.demonstration.core_waits import WaitsOf
from visloc_companion.evaluate.ended_in_order import ended_in_order
from visloc_companion.prepare.world import ProceduralWorld
from visloc_companion.sim.flight import FlightLog, TruthSample
from visloc_companion.sim.server import ServerPlan
from visloc_companion.sim.setup import FlightSetup
from visloc_companion.types import GeoPoint

FRAME_RATE_HZ = 2.5
STARTUP_S = 60.0
SHUTDOWN_S = 15.0
WAITS = "computer.json"
"""In the demonstration's folder: how long its processes waited for a core (core_waits.CoreWaits)."""
KILLED_S = 5.0

OURS = "# Written by the demonstration"

Stage = Callable[[str], None]
Disturb = Callable[[ServerPlan, "subprocess.Popen[bytes]"], None]
"""Is given the flight's plan and the daemon."""


def require_ours(out: Path) -> None:
    """A demonstration replaces its own files of before; nobody else's journals and configurations. Raises ConfigError."""
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


def fly_processes(
    out: Path,
    setup: FlightSetup,
    world: ProceduralWorld,
    speed: float,
    on_stage: Stage,
    disturb: Disturb | None = None,
) -> FlightLog:
    """Fly a scenario of FLIGHTS with both processes and leave plan, configuration, logs, journal and WAITS in `out`, which
    loses the journals of the flight before (`require_ours` first).

    `disturb` is called some five times a second while they run. Raises LinkError where one of them ended early or never.
    """
    plan = _plan(out, setup, world, speed)
    plan.save(out / "plan.json")
    config = out / "visloc.toml"
    status_socket = _status_socket(out)
    config.write_text(_config_text(setup, plan, world, status_socket), encoding="utf-8")
    for old in (*out.glob("*.mcap"), out / WAITS):
        old.unlink(missing_ok=True)
    flown = f"flying {setup.scenario.duration_s:.0f} s at {speed:.2g} times real time, daemon and autopilot over UDP"
    on_stage(f"{flown}; to watch: visloc web --config {config}" if status_socket else flown)
    with (
        ended_in_order(),
        (out / "autopilot.log").open("wb") as pilot_log,
        (out / "daemon.log").open("wb") as daemon_log,
    ):
        pilot = _started([sys.executable, "-m", "visloc_companion.sim.server", str(out / "plan.json")], stderr=pilot_log)
        daemon = _started(
            [sys.executable, "-m", "visloc_companion.cli.main", "run", "--config", str(config)],
            stderr=daemon_log,
            stdout=daemon_log,
        )
        waits = WaitsOf(daemon.pid, pilot.pid)

        def meanwhile() -> None:
            if any(out.glob("*.mcap")):  # the daemon has started, which takes all cores that there are
                waits.look()
            if disturb is not None:
                disturb(plan, daemon)

        try:
            _wait(pilot, daemon, out, setup.scenario.duration_s / speed, meanwhile)
        finally:
            _stop(daemon)
            _stop(pilot)
    if (found := waits.found(speed)) is not None:
        found.save(out / WAITS)
    return _log_of(json.loads(Path(plan.result).read_text(encoding="utf-8")), setup.scenario.duration_s)


def _started(command: Sequence[str], **files: IO[bytes]) -> subprocess.Popen[bytes]:
    """A process that ends with this one, also where that is killed: the daemon would go on for ever."""
    return subprocess.Popen(command, preexec_fn=end_with_starter, **files)  # type: ignore[call-overload,no-any-return] # noqa: PLW1509


def _wait(
    pilot: subprocess.Popen[bytes],
    daemon: subprocess.Popen[bytes],
    out: Path,
    flight_s: float,
    meanwhile: Callable[[], None] | None = None,
) -> None:
    end = time.monotonic() + flight_s + STARTUP_S
    while (code := pilot.poll()) is None:
        if daemon.poll() is not None:
            raise LinkError(f"the daemon ended early: {_tail(out / 'daemon.log')}", where=str(out / "daemon.log"))
        if time.monotonic() > end:
            raise LinkError("the simulated flight did not end in time", where=str(out / "autopilot.log"))
        if meanwhile is not None:
            meanwhile()
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
            with suppress(subprocess.TimeoutExpired):  # a signal may have left Popen's lock held, and the wait would have no end
                process.wait(KILLED_S)


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


def journal_of(out: Path) -> Path:
    """The journal that the daemon left. Raises LinkError where there is none."""
    found = sorted(out.glob("*.mcap"))
    if not found:
        raise LinkError("the daemon wrote no journal", where=str(out), remedy=f"see {out / 'daemon.log'}")
    return found[-1]


def _log_of(result: dict[str, Any], duration_s: float) -> FlightLog:
    truth = [TruthSample(int(t_ns), GeoPoint(lat, lon, h), None) for t_ns, lat, lon, h in result["truth"]]
    return FlightLog([], truth, result["failsafe"], float(result["pulled_m"]), duration_s)


def _tail(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace")[-1500:].strip()
