"""`visloc demo`: its last line, its JSON and its exit codes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from visloc_companion.cli.demo import demo as command
from visloc_companion.errors import ConfigError, LinkError
from visloc_companion.evaluate.demonstration import demo
from visloc_companion.evaluate.demonstration.core_waits import CoreWaits
from visloc_companion.evaluate.gate import Check
from visloc_companion.types import AutopilotKind

app = typer.Typer()
app.command()(command)
CHECKS = [
    Check("median error without GNSS", "0.8 m", "≤ 2 m", True),
    Check("largest error without GNSS", "4 m", "≤ 10 m", True),
    Check("pulled by false GNSS", "16 m", "≤ 30 m", True),
    Check("failsafe", "none", "none", True),
    Check("autopilot off without the daemon", "170 m", "> 100 m", True),
]


def run(
    monkeypatch: pytest.MonkeyPatch, checks: list[Check], *arguments: str | Path, waits: CoreWaits | None = None
) -> tuple[int, str, list[Any]]:
    """The command over a demonstration that showed this."""
    passed, asked = all(check.passed for check in checks), list[Any]()

    def run_demo(*told: Any) -> SimpleNamespace:
        asked.extend(told)
        told[-1]("flying")
        result = {"scenario": "demo", "passed": passed}
        flown = SimpleNamespace(checks=checks)
        return SimpleNamespace(flown=flown, passed=passed, report=Path("r.html"), waits=waits, as_json=lambda: result)

    monkeypatch.setattr(demo, "run_demo", run_demo)
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, asked


def test_a_pass_ends_with_one_line_of_figures(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    arguments = "--out", tmp_path / "out", "--dialect", "px4", "--speed", "3", "--json", tmp_path / "demo.json"
    code, text, asked = run(monkeypatch, CHECKS, *arguments)
    assert code == 0
    assert asked[:3] == [tmp_path / "out", AutopilotKind.PX4, 3.0]
    lines = text.splitlines()
    assert lines[0] == "ok   median error without GNSS: 0.8 m (required ≤ 2 m)"
    assert lines[-2] == "report: r.html"
    assert lines[-1] == (
        "PASS: without GNSS median 0.8 m, largest 4 m; spoof pulled 16 m; failsafe none; without the daemon 170 m off"
    )
    assert json.loads((tmp_path / "demo.json").read_text(encoding="utf-8")) == {"scenario": "demo", "passed": True}


def test_a_requirement_that_is_missed_exits_with_1(monkeypatch: pytest.MonkeyPatch) -> None:
    checks = [replace(CHECKS[0], value="3 m", passed=False), *CHECKS[1:]]
    code, text, _ = run(monkeypatch, checks)
    assert code == 1
    assert text.splitlines()[0].startswith("FAIL median error without GNSS: 3 m")
    assert text.splitlines()[-1].startswith("FAIL: without GNSS median 3 m")


@pytest.mark.parametrize(
    ("waits", "told"),
    [
        (
            CoreWaits(40.0, 594.0, 0.292, 2.0),
            "the computer was busy: daemon and autopilot computed for 40 s and waited for a core for 594 s, the daemon's main "
            "thread up to 292 ms at once. That alone makes positions late: run it again with nothing beside it",
        ),
        (CoreWaits(132.0, 20.0, 0.150, 2.0), "the computer was busy"),
        (CoreWaits(132.0, 20.0, 0.150, 0.5), "the computer was not too busy"),
        (
            CoreWaits(132.0, 20.0, 0.012, 2.0),
            "the computer was not too busy: daemon and autopilot computed for 132 s and waited for a core for 20 s, the daemon's "
            "main thread up to 12 ms at once. Look for a fault, in the report and in daemon.log",
        ),
        (None, "the computer is not known to have been busy or not: run it again with nothing beside it"),
    ],
)
def test_a_fail_tells_a_busy_computer_from_a_fault(monkeypatch: pytest.MonkeyPatch, waits: CoreWaits | None, told: str) -> None:
    """Positions 446 ms apart beside other work read like a fault of the daemon. It is missed all the same."""
    checks = [*CHECKS[:3], Check("longest gap between injections", "446 ms", "≤ 200 ms", False), *CHECKS[3:]]
    code, text, _ = run(monkeypatch, checks, waits=waits)
    assert code == 1
    assert text.splitlines()[-3].startswith(told) and text.splitlines()[-1].startswith("FAIL: ")
    code, text, _ = run(monkeypatch, CHECKS, waits=waits)
    assert code == 0 and "the computer" not in text


def test_an_unknown_dialect_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match="unknown dialect 'betaflight'"):
        run(monkeypatch, CHECKS, "--dialect", "betaflight")


def test_a_missing_folder_is_found_before_the_flight(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="its folder does not exist"):
        run(monkeypatch, CHECKS, "--json", tmp_path / "none" / "demo.json")


def test_a_full_disk_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def run_demo(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(demo, "run_demo", run_demo)
    why = CliRunner().invoke(app, ["--out", str(tmp_path)]).exception
    assert isinstance(why, ConfigError)
    assert (
        str(why) == f"{tmp_path}: cannot be written: [Errno 28] No space left on device; remedy: name a writable folder for --out"
    )


def test_a_process_that_ended_early_is_an_error_of_the_link(monkeypatch: pytest.MonkeyPatch) -> None:
    def run_demo(*_: Any) -> None:
        raise LinkError("the daemon ended early", where="daemon.log")

    monkeypatch.setattr(demo, "run_demo", run_demo)
    assert isinstance(CliRunner().invoke(app, []).exception, LinkError)
