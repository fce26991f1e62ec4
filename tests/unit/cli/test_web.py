"""`visloc web`: what it takes, what it refuses and how it says so."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path
from socket import SOCK_STREAM

import pytest
from typer.testing import CliRunner

from visloc_companion.app.journal import JournalHeader, JournalWriter
from visloc_companion.cli import web as module
from visloc_companion.cli.main import app
from visloc_companion.errors import ConfigError, JournalError, MapError
from visloc_companion.testing.loopback import free_port
from visloc_companion.types import Mode, Status, Verdict
from visloc_companion.web import extra

HEAVY = {"cv2", "numpy", "rasterio", "starlette", "uvicorn", "pydantic"}


def error_of(*words: str) -> BaseException | None:
    return CliRunner().invoke(app, ["web", *words]).exception


def test_without_the_extra_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extra, "find_spec", lambda name: None if name == "uvicorn" else object())
    error = error_of()
    assert isinstance(error, ConfigError)
    assert (error.what, error.where) == ("needs uvicorn", "visloc web")
    assert "pip install 'visloc-companion[web]'" in error.remedy


def test_its_help_loads_nothing_heavy() -> None:
    code = f"import sys, visloc_companion.cli.web; print(sorted({HEAVY!r} & sys.modules.keys()))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "[]"


def test_a_live_page_loads_no_localiser_and_no_autopilot() -> None:
    """It runs beside the daemon, in memory that the daemon may need."""
    code = (
        "import sys, visloc_companion.web.server, visloc_companion.web.serve, visloc_companion.web.daemon_socket; "
        "print(sorted({'onnxruntime', 'pymavlink', 'open3d', 'filterpy', 'mcap', 'cv2', 'rasterio'} & sys.modules.keys()))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "[]"


def test_a_configuration_without_a_socket_is_refused_with_the_remedy(tmp_path: Path) -> None:
    (tmp_path / "visloc.toml").write_text('[link]\nurl = "udpin:127.0.0.1:14550"\n')
    error = error_of("--config", str(tmp_path / "visloc.toml"))
    assert isinstance(error, ConfigError)
    assert "status.socket" in error.what
    assert str(module.SOCKET) in error.remedy


@pytest.mark.parametrize("more", [["--socket", "s"], ["--config", "c.toml"]])
def test_a_recording_has_no_daemon(tmp_path: Path, more: list[str]) -> None:
    error = error_of("--journal", str(tmp_path / "j.mcap"), *more)
    assert isinstance(error, ConfigError)
    assert error.where == "--journal"


def test_only_a_recording_has_a_speed() -> None:
    error = error_of("--speed", "4")
    assert isinstance(error, ConfigError)
    assert error.where == "--speed"


def test_a_journal_or_a_map_that_cannot_be_opened_is_an_error_of_data(tmp_path: Path) -> None:
    assert isinstance(error_of("--journal", str(tmp_path / "none.mcap")), JournalError)
    assert isinstance(error_of("--map", str(tmp_path)), MapError)


def test_a_recording_is_shown_over_the_map_that_it_was_flown_with(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    writer = JournalWriter(path.open("xb"), JournalHeader({"map": {"pack": "/maps/field"}}), path=path)
    nowhere = ((0.0, 0.0), (0.0, 0.0))
    writer.command(
        1, Status(1, Mode.WAITING, Verdict.DENIED, ("no_data",), None, (0.0, 0.0, 0.0), nowhere, 0.0, None, None, False, 0)
    )
    writer.close()
    source, pack = module._recorded(path, 2.0)
    assert (source.origin.name, source.origin.speed, pack) == ("flight.mcap", 2.0, Path("/maps/field"))


def test_the_daemons_own_map_that_cannot_be_opened_costs_only_the_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pictures, problem = module._pictures(None, tmp_path / "none")
    assert pictures is None
    assert "none" in problem
    assert capsys.readouterr().err.startswith("warning: no map is shown: ")


def test_beyond_loopback_it_warns_of_who_sees_the_position(capsys: pytest.CaptureFixture[str]) -> None:
    module._say("127.0.0.1", 8480, "s", open_to_all=False)
    assert "warning" not in capsys.readouterr().err
    module._say("::", 8480, "s", open_to_all=True)
    said = capsys.readouterr().err
    assert "http://[::]:8480/" in said
    assert "warning: anyone on that network sees where the vehicle is" in said


def test_it_serves_until_it_is_told_to_stop(tmp_path: Path) -> None:
    port = free_port(SOCK_STREAM)
    command = [sys.executable, "-m", "visloc_companion.cli.main", "web", "--socket", str(tmp_path / "s"), "--port", str(port)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as server:
        try:
            assert server.stderr is not None
            assert f"http://127.0.0.1:{port}/" in server.stderr.readline()
            for _ in range(100):
                with urllib.request.urlopen(f"http://127.0.0.1:{port}/api/status") as answer:
                    status = json.load(answer)
                if status["says"] != "Not asked yet.":
                    break
                time.sleep(0.05)
            assert status["says"] == f"No daemon answers at {tmp_path / 's'}: there is no such socket."
            server.send_signal(signal.SIGTERM)
            assert server.wait(20) == 0
            assert server.stderr.read() == ""
        finally:
            server.kill()
