"""`visloc run` as a process: exit codes, the tree of problems, --check, a clean end."""

from __future__ import annotations

import contextlib
import gc
import json
import os
import signal
import socket
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import pytest

from visloc_companion.app.journal import read_header, read_journal
from visloc_companion.cli import run
from visloc_companion.config import Config, parse_config

COMMAND = [sys.executable, "-m", "visloc_companion.cli.main", "run", "--config"]
ENVIRONMENT = {**os.environ, "COLUMNS": "200", "NO_COLOR": "1"}


def configuration(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "visloc.toml"
    path.write_text(text)
    return path


def visloc_run(path: Path, *options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*COMMAND, str(path), *options], capture_output=True, text=True, timeout=100, check=False, env=ENVIRONMENT
    )


@contextmanager
def started(path: Path, stderr: int = subprocess.PIPE) -> Iterator[subprocess.Popen[str]]:
    """The daemon, which never outlives the test. Tests that run under `nohup` would hand on to it that SIGHUP is ignored."""
    listening = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    try:
        process = subprocess.Popen([*COMMAND, str(path)], stderr=stderr, text=True, env=ENVIRONMENT)
    finally:
        signal.signal(signal.SIGHUP, listening)
    with process:
        try:
            yield process
        finally:
            process.kill()


def test_check_prints_the_effective_configuration(tmp_path: Path) -> None:
    path = configuration(tmp_path, '[link]\nurl = "udpin:127.0.0.1:14550"\n[navigator]\noutput_rate_hz = 20\n')
    done = visloc_run(path, "--check", "--json", str(tmp_path / "found.json"))
    assert (done.returncode, done.stderr) == (0, "")
    effective = parse_config(tomllib.loads(done.stdout))
    assert effective == parse_config(tomllib.loads(path.read_text()))
    assert "gate_sigma = 4.0" in done.stdout
    found = json.loads((tmp_path / "found.json").read_text())
    assert (found["schema"], found["problems"]) == (1, [])
    assert found["configuration"]["navigator"]["output_rate_hz"] == 20
    assert found["found"]["versions"]["visloc-companion"]


def test_a_result_of_check_that_cannot_be_written_is_a_matter_of_usage(tmp_path: Path) -> None:
    path = configuration(tmp_path, '[link]\nurl = "udpin:127.0.0.1:0"\n')
    for options in (("--check", "--json", str(tmp_path / "missing" / "found.json")), ("--json", str(tmp_path / "found.json"))):
        done = visloc_run(path, *options)
        assert (done.returncode, done.stdout) == (2, "")
        assert done.stderr.startswith("error: ") and done.stderr.count("\n") == 1 and "--json" in done.stderr


def test_a_first_position_that_is_none_is_refused_before_anything_starts(tmp_path: Path) -> None:
    done = visloc_run(configuration(tmp_path, ""), "--at", "47.0;8.0")
    assert done.returncode == 2
    assert "--at LAT,LON" in done.stderr


def test_a_camera_that_no_lens_makes_is_refused_by_file_and_field(tmp_path: Path) -> None:
    (tmp_path / "frames.csv").write_text("t_us, file\n0, a.png\n")
    text = f'[link]\nurl = "udpin:127.0.0.1:0"\n[camera]\nurl = "files:{tmp_path}"\nfx_px = 5\n[map]\npack = "/none"\n'
    path = configuration(tmp_path, text)
    for done in (visloc_run(path, "--check"), visloc_run(path)):
        assert done.returncode == 2
        assert f"visloc cannot run with {path}" in done.stderr and "remedy: write the focal length" in done.stderr
        assert "camera.fx_px: 5 px are a view of 178° over the 640 px of the picture" in done.stderr


@pytest.mark.parametrize(
    ("lens", "unstated"),
    [
        ("", "width_px, height_px, fx_px, fy_px, cx_px, cy_px"),
        ("width_px = 640\nheight_px = 480\nfx_px = 500.0\nfy_px = 500.0\n", "cx_px, cy_px"),
        ("width_px = 640\nheight_px = 480\nfx_px = 500.0\nfy_px = 500.0\ncx_px = 319.5\ncy_px = 239.5\n", ""),
    ],
)
def test_a_lens_that_nobody_stated_is_not_assumed(tmp_path: Path, lens: str, unstated: str) -> None:
    """A camera's frames were placed as those of a lens of 500 px, whatever its own, and nobody was told."""
    text = f'[link]\nurl = "udpin:127.0.0.1:0"\n[camera]\nurl = "tcp:127.0.0.1:1"\n{lens}[map]\npack = "/none"\n'
    path = configuration(tmp_path, text)
    for done in (visloc_run(path, "--check"), visloc_run(path)):
        told = "remedy: write the calibration's values: none is assumed (docs/on-a-drone.md, Calibration)"
        assert done.returncode == (2 if unstated else 3)
        assert (f"camera: {unstated} not stated, but camera.url is set" in done.stderr) is bool(unstated)
        assert (told in done.stderr) is bool(unstated)


def test_check_names_every_problem_in_one_tree(tmp_path: Path) -> None:
    text = '[link]\nurl = "pigeon:home"\n[camera]\nurl = "teleport:x"\n[map]\npack = "/none"\n[journal]\nfolder = "/proc/none"\n'
    done = visloc_run(configuration(tmp_path, text), "--check", "--json", str(tmp_path / "found.json"))
    assert done.returncode == 2
    for part in ("visloc cannot run", "pigeon", "'teleport:x' names no camera", "/none", "/proc/none", "remedy: "):
        assert part in done.stderr
    assert len(json.loads((tmp_path / "found.json").read_text())["problems"]) == 4


@pytest.mark.parametrize(
    ("text", "code", "what"),
    [
        ('[localiser]\nterrain = true\n[map]\npack = "/none"\n', 3, "/none/manifest.json: there is no such file"),
        ("[localiser]\nterrain = true\n", 2, "map.pack: is empty, but localiser.terrain is set"),
        ('[status]\nsocket = "/none/status.sock"\n', 2, "/none/status.sock: no status socket"),
    ],
)
def test_check_finds_what_the_start_would_fail_of(tmp_path: Path, text: str, code: int, what: str) -> None:
    path = configuration(tmp_path, f'[link]\nurl = "udpin:127.0.0.1:0"\n{text}')
    for done in (visloc_run(path, "--check"), visloc_run(path)):
        assert done.returncode == code
        assert what in done.stderr


def test_check_misses_a_serial_device_that_a_start_would_wait_for(tmp_path: Path) -> None:
    there, absent = tmp_path / "tty", tmp_path / "ttyAMA0"
    there.touch()
    done = [
        visloc_run(configuration(tmp_path, f'[link]\nurl = "serial:{device}:921600"\n'), "--check") for device in (there, absent)
    ]
    assert [each.returncode for each in done] == [0, 4]
    assert f"link.url: {absent} does not exist" in done[1].stderr and "remedy: check the name" in done[1].stderr


def test_no_problem_is_cut_at_the_width_of_a_terminal_that_is_not_there(tmp_path: Path) -> None:
    path = configuration(tmp_path, f'[map]\npack = "/none/{"far/" * 40}"\n')
    environment = {name: value for name, value in ENVIRONMENT.items() if name != "COLUMNS"}
    done = subprocess.run([*COMMAND, str(path)], capture_output=True, text=True, timeout=100, check=False, env=environment)
    assert done.returncode == 3
    assert "far/manifest.json: there is no such file\n" in done.stderr
    assert "or build one (visloc map build)\n" in done.stderr


@pytest.mark.parametrize(
    ("text", "code", "what"),
    [
        ("[link]\nulr = 1\n", 2, "did you mean 'url'"),
        ("not toml", 2, "is not valid TOML"),
        ('[link]\nurl = "udp:1"\n', 2, "is no kind of connection"),
        ('[journal]\nfolder = "/proc/none"\n', 3, "remedy: name a writable journal.folder"),
    ],
)
def test_exit_codes_of_a_start_that_fails(tmp_path: Path, text: str, code: int, what: str) -> None:
    done = visloc_run(configuration(tmp_path, text))
    assert done.returncode == code
    assert what in done.stderr
    assert "Traceback" not in done.stderr


def test_a_missing_configuration(tmp_path: Path) -> None:
    done = visloc_run(tmp_path / "none.toml")
    assert done.returncode == 2
    assert "cannot be read" in done.stderr


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_ends_it_cleanly_with_a_whole_journal(tmp_path: Path, number: signal.Signals) -> None:
    journals = tmp_path / "journals"
    path = configuration(tmp_path, f'[link]\nurl = "udpin:127.0.0.1:0"\n[journal]\nfolder = "{journals}"\n')
    with started(path) as process:
        assert process.stderr is not None
        lines = [process.stderr.readline()]
        assert json.loads(lines[0])["event"] == "ready"
        process.send_signal(number)
        rest = process.stderr.read()
        assert process.wait(60) == 0
    assert json.loads(rest.splitlines()[-1])["event"] == "stopped"
    (journal,) = journals.glob("*.mcap")
    list(read_journal(journal, salvage=False))
    assert read_header(journal).configuration["journal"]["folder"] == str(journals)


@pytest.mark.parametrize("log", ["on a full disk", "that nobody reads"])
def test_a_log_that_cannot_be_written_neither_ends_nor_holds_it(tmp_path: Path, log: str) -> None:
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writer, bytes(4096))
    os.set_blocking(writer, True)
    full = os.open("/dev/full", os.O_WRONLY)
    address = tmp_path / "status.sock"
    path = configuration(tmp_path, f'[link]\nurl = "udpin:127.0.0.1:0"\n[status]\nsocket = "{address}"\n')
    with started(path, full if log == "on a full disk" else writer) as process:
        answers = [answer(process, address) for _ in range(2)]
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0
    for descriptor in (reader, writer, full):
        os.close(descriptor)
    assert answers[1]["t_ns"] > answers[0]["t_ns"] and answers[1]["late"] == []


def answer(process: subprocess.Popen[str], address: Path) -> dict[str, Any]:
    """What the status socket says, a second after it is there."""
    for _ in range(600):
        if address.exists() or process.poll() is not None:
            break
        time.sleep(0.1)
    time.sleep(1.0)
    with socket.socket(socket.AF_UNIX) as asking:
        asking.settimeout(10)
        asking.connect(str(address))
        said: dict[str, Any] = json.loads(asking.makefile().read())
    return said


def test_a_restart_begins_a_journal_of_its_own(tmp_path: Path) -> None:
    journals = tmp_path / "journals"
    path = configuration(tmp_path, f'[link]\nurl = "udpin:127.0.0.1:0"\n[journal]\nfolder = "{journals}"\n')
    for number in (signal.SIGKILL, signal.SIGTERM):
        with started(path) as process:
            assert process.stderr is not None
            process.stderr.readline()
            process.send_signal(number)
            process.stderr.read()
    assert len(list(journals.glob("*.mcap"))) == 2


def test_a_flight_looks_for_no_garbage_among_what_was_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    frozen: list[int] = []

    async def daemon(*_: object, **__: object) -> None:
        frozen.append(gc.get_freeze_count())

    monkeypatch.setattr("visloc_companion.app.live.run_daemon", daemon)
    try:
        assert run._serve(cast(Config, None), None) == []
    finally:
        gc.unfreeze()
    assert frozen[0] > 10_000
