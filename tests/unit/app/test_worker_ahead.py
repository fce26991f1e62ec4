"""A worker's process that is begun before the configuration is read."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.unit.processes import gone
from visloc_companion.app import worker_ahead
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.app.slots import SharedFrameSlots
from visloc_companion.app.worker import WorkerSupervisor
from visloc_companion.app.worker_ahead import NEEDED, WorkerAhead, ahead_for
from visloc_companion.config import Config
from visloc_companion.types import CameraModel

MODEL = CameraModel(64, 48, 50.0, 50.0, 31.5, 23.5)


@pytest.fixture(autouse=True)
def answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parent)


async def started(ahead: WorkerAhead) -> tuple[int, list[str]]:
    """The number of the worker's process that a supervisor started with it, and what was said."""
    slots, said = SharedFrameSlots(MODEL), list[str]()
    worker = WorkerSupervisor(
        Config(),
        slots,
        MonotonicClock(),
        on_notice=lambda notice: said.append(notice.text),
        factory="answers:prior_is_right",
        ahead=ahead,
    )
    try:
        await worker.start()
        assert worker.up
        return int(worker.pid or 0), said
    finally:
        await worker.close()
        slots.close()


async def test_it_becomes_the_first_worker() -> None:
    ahead = WorkerAhead()
    pid = ahead._process.pid
    assert await started(ahead) == (pid, [])
    ahead.close()
    assert gone(pid)


async def test_one_that_is_dead_is_replaced() -> None:
    ahead = WorkerAhead()
    pid = ahead._process.pid
    ahead._process.kill()
    ahead._process.join()
    worker_pid, said = await started(ahead)
    assert worker_pid not in (0, pid)
    assert said == []


def test_one_that_nobody_took_ends() -> None:
    ahead = WorkerAhead()
    pid = ahead._process.pid
    ahead.close()
    assert gone(pid)
    ahead.close()


@pytest.mark.parametrize(
    ("text", "begun"),
    [
        ('[map]\npack = "p"\n[camera]\nurl = "tcp:a:1"\n', True),
        ('[map]\npack = "p"\n[localiser]\nterrain = true\n', True),
        ('[map]\npack = "p"\n', False),
        ('[camera]\nurl = "tcp:a:1"\n', False),
        ('map = 3\n[camera]\nurl = "tcp:a:1"\n', False),
        ('camera = 3\n[map]\npack = "p"\n', False),
        ("[map\n", False),
    ],
)
def test_only_for_a_configuration_that_seems_to_need_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, begun: bool
) -> None:
    made = list[object]()
    monkeypatch.setattr(worker_ahead, "WorkerAhead", lambda: made.append(1) or made)
    path = tmp_path / "visloc.toml"
    path.write_text(text)
    assert (ahead_for(path) is not None) is begun
    assert len(made) == begun


def test_without_a_configuration_none_is_begun(tmp_path: Path) -> None:
    assert ahead_for(tmp_path / "none.toml") is None


def test_it_is_begun_before_anything_that_takes_long_to_import() -> None:
    code = "import sys, visloc_companion.app.worker_ahead, visloc_companion.cli.start; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert {"numpy", "pydantic", "asyncio", "typer", "structlog", "visloc_companion.app.worker_process", *NEEDED} & set(
        done.stdout.split()
    ) == set()


def test_what_it_imports_keeps_no_record_of_the_computer(tmp_path: Path) -> None:
    """onnxruntime asks whether it may once, when it is imported: else a number of the computer and its sessions are in HOME."""
    code = (
        "import sys; from multiprocessing import Pipe; from visloc_companion.app.worker_ahead import wait_for_job\n"
        "ours, theirs = Pipe(); ours.close(); wait_for_job(theirs)\n"
        "import onnxruntime; onnxruntime.get_available_providers(); print('onnxruntime' in sys.modules)"
    )
    surroundings = {name: value for name, value in os.environ.items() if name != "ORT_DISABLE_TELEMETRY"}
    surroundings |= {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=surroundings, capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.strip() == "True"
    assert [path.name for path in tmp_path.rglob("*onnxruntime*")] == []


@pytest.mark.parametrize(("terrain", "loaded"), [(False, []), (True, ["scipy.ndimage", "scipy.spatial"])])
def test_what_answers_about_the_ground_alone_holds_up_no_start_without_a_rangefinder(terrain: bool, loaded: list[str]) -> None:
    lines = (
        "import sys, visloc_companion.app.localiser, visloc_companion.maps.pack",
        "from visloc_companion.app.terrain import configured_terrain",
        "from visloc_companion.config import LocaliserConfig",
        f"configured_terrain(LocaliserConfig(terrain={terrain}), None)",
        "print([m for m in ('scipy.ndimage', 'scipy.spatial') if m in sys.modules])",
    )
    done = subprocess.run([sys.executable, "-c", "; ".join(lines)], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == str(loaded)


@pytest.mark.parametrize("primitives", ["", "disabled"])
def test_scipy_is_loaded_ahead_where_its_transform_is_needed_and_nowhere_else(primitives: str) -> None:
    parts = "{'scipy.fft', 'scipy.special'} & {*sys.modules}"
    code = f"import sys, cv2, visloc_companion.app.localiser; print(cv2.ipp.useIPP(), *{parts})"
    surroundings = os.environ | {"OPENCV_IPP": primitives}
    done = subprocess.run([sys.executable, "-c", code], env=surroundings, capture_output=True, text=True, timeout=60, check=True)
    has_primitives, *loaded = done.stdout.split()
    assert set(loaded) == (set() if has_primitives == "True" else {"scipy.fft", "scipy.special"})
    assert loaded or primitives == ""


def test_a_start_that_fails_leaves_none(tmp_path: Path) -> None:
    """A configuration that is wrong ends the command at once, and with it the process that would wait for ever."""
    path = tmp_path / "visloc.toml"
    path.write_text('[map]\npack = "p"\n[camera]\nurl = "tcp:127.0.0.1:1"\nno_such_key = 1\n')
    command = [sys.executable, "-c", "from visloc_companion.cli.start import main; main()", "run", "--config", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert "no_such_key" in done.stderr
    assert "Traceback" not in done.stderr


def test_signals_to_the_whole_group_do_not_reach_it() -> None:
    """Ctrl-C and a terminal that goes away are the daemon's business. The first process that multiprocessing starts is its
    resource tracker, and with that it unblocks what was blocked."""
    lines = (
        "from pathlib import Path",
        "from visloc_companion.app.worker_ahead import WorkerAhead",
        "ahead = WorkerAhead()",
        "from multiprocessing.resource_tracker import _resource_tracker as tracker",
        "pids = ahead._process.pid, tracker._pid",
        "statuses = [Path(f'/proc/{pid}/status').read_text() for pid in pids]",
        "ahead.close()",
        "for status in statuses:",
        "    print(next(line for line in status.splitlines() if line.startswith('SigBlk')).split()[1])",
    )
    done = subprocess.run([sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, timeout=60, check=True)
    worker, tracker = (int(line, 16) for line in done.stdout.splitlines())
    assert all(worker >> (number - 1) & 1 for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP))
    assert tracker >> (signal.SIGHUP - 1) & 1  # the others it ignores
