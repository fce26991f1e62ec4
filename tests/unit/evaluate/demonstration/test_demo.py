"""The demonstration: what its processes are told, what becomes of their ends, and how the flight is judged."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from visloc_companion.adapters.camera.calibration import camera_model
from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.app.settings import core_settings
from visloc_companion.config import load_config
from visloc_companion.core.navigator import Navigator
from visloc_companion.errors import ConfigError, LinkError
from visloc_companion.evaluate.closed_loop import simulated_config
from visloc_companion.evaluate.demonstration import demo, demo_processes
from visloc_companion.evaluate.demonstration.core_waits import load_waits
from visloc_companion.evaluate.demonstration.demo import run_demo
from visloc_companion.localise.features import onnx
from visloc_companion.prepare.world import ProceduralWorld
from visloc_companion.sim.flight import ClosedLoopFlight, Eyes, FlightLog
from visloc_companion.sim.scenarios import DEMO
from visloc_companion.sim.server import ServerPlan
from visloc_companion.sim.setup import FlightArea, FlightSetup
from visloc_companion.types import AutopilotKind, GeoPoint

MakeEyes = Callable[..., Eyes]
SETUP = FlightSetup(DEMO, FlightArea(GeoPoint(47.4, 8.55, 480.0), 1000.0, 0.5, 0.1), AutopilotKind.PX4, "copter", 1)


@pytest.fixture
def world(tiny_world: Any) -> ProceduralWorld:
    return ProceduralWorld(tiny_world.pack, tiny_world.ortho, tiny_world.dsm)


def test_the_daemon_is_told_what_the_autopilot_is_told(world: ProceduralWorld, tmp_path: Path) -> None:
    """Ports, camera, clock and pack of both processes fit together, in a file that the daemon accepts."""
    plan = demo_processes._plan(tmp_path, SETUP, world, 2.0)
    plan.save(tmp_path / "plan.json")
    assert ServerPlan.load(tmp_path / "plan.json") == plan
    assert plan.setup() == SETUP
    path = tmp_path / "visloc.toml"
    path.write_text(demo_processes._config_text(SETUP, plan, world, demo_processes._status_socket(tmp_path)), encoding="utf-8")
    config = load_config(path)
    assert config.link.url == f"udpin:127.0.0.1:{plan.mavlink_port}"
    assert config.camera.url == f"tcp:127.0.0.1:{plan.camera_port}"
    assert camera_model(config.camera) == SETUP.camera_model()
    assert config.clock.speed == plan.speed == 2.0
    assert config.localiser.max_rate_hz == plan.frame_rate_hz
    assert Path(config.map.pack) == world.pack
    assert Path(config.journal.folder) == tmp_path
    assert config.injection.switch_source
    assert config.status.socket == str(tmp_path / "status.sock")


def test_where_no_socket_can_be_the_demonstration_flies_without_a_dashboard(world: ProceduralWorld, tmp_path: Path) -> None:
    """A Unix socket's path has 107 bytes at most: in a deep folder the daemon would refuse its configuration."""
    deep = tmp_path / ("a" * 100)
    deep.mkdir()
    path = deep / "visloc.toml"
    plan = demo_processes._plan(deep, SETUP, world, 2.0)
    path.write_text(demo_processes._config_text(SETUP, plan, world, demo_processes._status_socket(deep)), encoding="utf-8")
    assert load_config(path).status.socket == ""
    assert not list(tmp_path.glob("*.mcap"))


@contextmanager
def processes(*codes: str) -> Iterator[list[subprocess.Popen[bytes]]]:
    running = [subprocess.Popen([sys.executable, "-c", code]) for code in codes]
    try:
        yield running
    finally:
        for process in running:
            demo_processes._stop(process)
            assert process.poll() is not None


SLEEPS = "import time; time.sleep(60)"


def test_a_daemon_that_ends_early_is_told_with_its_log(tmp_path: Path) -> None:
    (tmp_path / "daemon.log").write_text("error: camera: no such device\n")
    with (
        processes(SLEEPS, "pass") as (pilot, daemon),
        pytest.raises(LinkError, match=r"ended early: error: camera: no such device"),
    ):
        demo_processes._wait(pilot, daemon, tmp_path, 30.0)


def test_an_autopilot_that_fails_is_told_with_its_log(tmp_path: Path) -> None:
    (tmp_path / "autopilot.log").write_text("error: plan\n")
    with (
        processes("raise SystemExit(2)", SLEEPS) as (pilot, daemon),
        pytest.raises(LinkError, match=r"autopilot ended early: error"),
    ):
        demo_processes._wait(pilot, daemon, tmp_path, 30.0)


def test_a_flight_that_does_not_end_is_broken_off(tmp_path: Path) -> None:
    with processes(SLEEPS, SLEEPS) as (pilot, daemon), pytest.raises(LinkError, match="did not end in time"):
        demo_processes._wait(pilot, daemon, tmp_path, -demo_processes.STARTUP_S)


def test_a_flight_may_be_disturbed_until_it_ends(tmp_path: Path) -> None:
    seen: list[int | None] = []
    with processes("import time; time.sleep(0.5)", SLEEPS) as (pilot, daemon):
        demo_processes._wait(pilot, daemon, tmp_path, 30.0, lambda: seen.append(daemon.poll()))
    assert len(seen) >= 1
    assert set(seen) == {None}


def test_a_flight_leaves_how_long_it_waited_for_a_core(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the daemon's first record on, and nothing of the flight before."""
    plan: Any = SimpleNamespace(speed=2.0, result=str(tmp_path / "truth.json"), save=lambda _: None)
    Path(plan.result).write_text("{}")
    seen: list[bool] = []

    def wait(pilot: object, daemon: object, out: Path, flight_s: float, meanwhile: Callable[[], None]) -> None:
        seen.append((out / demo_processes.WAITS).exists())
        meanwhile()
        (out / "visloc-20260401T101500Z.mcap").touch()
        for _ in range(3):
            time.sleep(0.1)
            meanwhile()

    spin = [sys.executable, "-S", "-c", "while True: pass"]
    stand_ins = ("_plan", lambda *_: plan), ("_config_text", lambda *_: ""), ("_wait", wait), ("_log_of", lambda *_: None)
    for name, stand_in in (*stand_ins, ("_started", lambda *_, **__: subprocess.Popen(spin))):
        monkeypatch.setattr(demo_processes, name, stand_in)
    told: list[int] = []
    (tmp_path / demo_processes.WAITS).write_text("of before")
    nothing: Any = None
    demo_processes.fly_processes(tmp_path, SETUP, nothing, 2.0, lambda _: None, lambda _, daemon: told.append(daemon.pid))
    found = load_waits(tmp_path / demo_processes.WAITS)
    assert seen == [False] and len(told) == 4
    assert found is not None and found.speed == 2.0 and found.computed_s + found.waited_s > 0.1


DEMONSTRATION = """
import sys
from pathlib import Path
from visloc_companion.evaluate.demonstration import demo_processes as told

def fly(pilot, daemon, *_):
    print(pilot.pid, daemon.pid, flush=True)
    pilot.wait(60)

class Sleeper(told.subprocess.Popen):
    def __init__(self, arguments, **more):
        super().__init__([sys.executable, "-c", "import time; time.sleep(60)"], **more)

class Plan:
    speed, result = 1.0, "none"
    def save(self, path):
        pass

class Setup:
    class scenario:
        duration_s = 60.0

told.subprocess.Popen, told._wait, told._plan, told._config_text = Sleeper, fly, lambda *_: Plan(), lambda *_: ""
told.fly_processes(Path(sys.argv[1]), Setup(), None, 1.0, lambda stage: None)
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT, signal.SIGKILL])
def test_whoever_ends_the_demonstration_ends_its_processes(tmp_path: Path, number: signal.Signals) -> None:
    """`timeout 60 visloc demo` left a daemon behind."""
    with subprocess.Popen(
        [sys.executable, "-c", DEMONSTRATION, tmp_path], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as parent:
        assert parent.stdout is not None
        children = [int(pid) for pid in parent.stdout.readline().split()]
        parent.send_signal(number)
        parent.wait(30)
    for _ in range(100):  # the kernel takes a moment
        left = [pid for pid in children if Path(f"/proc/{pid}").exists()]
        if not left:
            break
        time.sleep(0.05)
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    assert len(children) == 2
    assert not left


def test_a_wait_that_a_signal_broke_off_is_not_waited_for_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A handler that raises just when Popen has taken its lock leaves it held: from then on no wait of it ever ends."""
    monkeypatch.setattr(demo_processes, "SHUTDOWN_S", 0.2)
    monkeypatch.setattr(demo_processes, "KILLED_S", 0.2)
    with subprocess.Popen([sys.executable, "-c", SLEEPS]) as process:
        lock: Any = vars(process)["_waitpid_lock"]
        with lock:
            demo_processes._stop(process)
        assert process.wait() in (-signal.SIGTERM, -signal.SIGKILL)


def test_a_process_that_ignores_the_signal_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo_processes, "SHUTDOWN_S", 0.3)
    stubborn = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print(flush=True); time.sleep(60)"
    process = subprocess.Popen([sys.executable, "-c", stubborn], stdout=subprocess.PIPE)
    with process:
        assert process.stdout is not None
        process.stdout.readline()
        demo_processes._stop(process)
    assert process.returncode == -9


def test_a_daemon_without_a_journal_is_told(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match=r"wrote no journal.*daemon\.log"):
        demo_processes.journal_of(tmp_path)


def test_a_folder_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match=r"cannot be made.*--out"):
        run_demo(tmp_path / "file" / "out", AutopilotKind.PX4, 2.0, lambda _: None)


@pytest.mark.parametrize("name", ["visloc.toml", "visloc-20260401T101500Z.mcap"])
def test_files_of_somebody_else_are_left_alone(tmp_path: Path, name: str) -> None:
    """Journals of real flights were deleted, a daemon's configuration written over."""
    (tmp_path / name).write_text("[link]\n")
    with pytest.raises(ConfigError, match=rf"holds {name}, which no demonstration wrote.*name a new folder for --out"):
        run_demo(tmp_path, AutopilotKind.PX4, 2.0, pytest.fail)
    assert (tmp_path / name).read_text() == "[link]\n"


def test_a_demonstration_takes_the_place_of_the_one_before(
    world: ProceduralWorld, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = demo_processes._plan(tmp_path, SETUP, world, 2.0)
    (tmp_path / "visloc.toml").write_text(demo_processes._config_text(SETUP, plan, world, ""))
    (tmp_path / "visloc-20260401T101500Z.mcap").touch()

    def on(*_: object) -> None:
        raise LinkError("far enough")

    monkeypatch.setattr(demo, "open_features_for", on)
    with pytest.raises(LinkError, match="far enough"):
        run_demo(tmp_path, AutopilotKind.PX4, 2.0, pytest.fail)


def test_without_onnxruntime_the_remedy_is_told_before_anything_is_made(
    network: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(onnx, "shipped_model", lambda: network)
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ConfigError, match=r"networks need onnxruntime.*visloc-companion\[cpu\].*gradient"):
        run_demo(tmp_path / "out", AutopilotKind.PX4, 2.0, pytest.fail)


@pytest.fixture
def fly_here(world: ProceduralWorld, monkeypatch: pytest.MonkeyPatch) -> Callable[[Eyes], None]:
    """In place of the two processes and their journal: the same flight in simulated time, in this process."""

    def prepare(eyes: Eyes) -> None:
        def fly(out: Path, setup: FlightSetup, *_: object) -> FlightLog:
            navigator = Navigator(core_settings(simulated_config(setup)))
            log = ClosedLoopFlight(setup.autopilot(), navigator, MavlinkSession(SessionSettings()), eyes).run(DEMO.duration_s)
            (out / "flight.mcap").touch()
            monkeypatch.setattr(demo, "read_journal", lambda _: log.entries)
            return log

        monkeypatch.setattr(demo, "open_features_for", lambda *_: None)
        monkeypatch.setattr(demo, "procedural_world", lambda *_, **__: world)
        monkeypatch.setattr(demo, "fly_processes", fly)

    return prepare


@pytest.mark.parametrize(
    ("cores", "longer", "speed"),
    [(2.0, 1.0, 2.0), (1.5, 1.0, 2.0), (0.75, 1.0, 1.0), (0.05, 1.0, 0.4), (1.5, 2.0, 4 / 3), (2.0, 1.5, 2.0)],
)
def test_on_a_busy_or_slow_computer_the_flight_goes_slower(
    world: ProceduralWorld, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cores: float, longer: float, speed: float
) -> None:
    flown: list[float] = []

    def fly(out: Path, setup: FlightSetup, files: ProceduralWorld, speed: float, on_stage: object) -> FlightLog:
        flown.append(speed)
        raise LinkError("far enough")

    stages: list[str] = []
    monkeypatch.setattr(demo, "open_features_for", lambda *_: None)
    for name, made in (("procedural_world", world), ("fly", None)):  # the flight without the daemon goes at no speed
        monkeypatch.setattr(demo, name, lambda *_, made=made, **__: made)
    monkeypatch.setattr(demo, "free_cores", lambda: cores)
    monkeypatch.setattr(demo, "slower", lambda: longer)
    monkeypatch.setattr(demo, "fly_processes", fly)
    for asked in (None, 3.0):
        with pytest.raises(LinkError, match="far enough"):
            run_demo(tmp_path / "out", AutopilotKind.PX4, asked, stages.append)
    assert flown == pytest.approx([speed, 3.0])
    assert len([stage for stage in stages if "cores" in stage]) == (speed < 2.0)


def test_a_good_flight_passes_and_is_reported(tmp_path: Path, oracle_eyes: MakeEyes, fly_here: Callable[[Eyes], None]) -> None:
    fly_here(oracle_eyes())
    stages: list[str] = []
    result = run_demo(tmp_path / "out", AutopilotKind.ARDUPILOT, 2.0, stages.append)
    assert result.passed, [check for check in result.flown.checks if not check.passed]
    assert stages == ["flying without the daemon", "writing the report"]
    names = [check.name for check in result.flown.checks]
    assert names[-1] == "autopilot off without the daemon"
    stated = json.loads(json.dumps(result.as_json(), allow_nan=False))
    assert stated["scenario"] == "demo"
    assert stated["passed"] is True
    assert stated["off_without_daemon_m"] > 100.0
    assert stated["gnss"]["detected_at_s"] == pytest.approx(75.0, abs=16.0)
    page = result.report.read_text(encoding="utf-8")
    assert page.count("PASS") >= 1
    assert "data:image/jpeg" in page
    assert "autopilot off without the daemon" in page
