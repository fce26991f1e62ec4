"""`visloc sim --autopilot`: what a flight against a real simulator writes, with the flight itself made by hand."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from visloc_companion.app.journal import JournalHeader, JournalWriter
from visloc_companion.cli.sim import sim
from visloc_companion.errors import ConfigError
from visloc_companion.evaluate.real import real_world
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.sim.real import apart
from visloc_companion.sim.real.clock import EPOCH_NS
from visloc_companion.sim.real.record import RealLog, RealSample
from visloc_companion.types import GeoPoint, Mode, Status, Verdict

HOME = GeoPoint(47.4, 8.5, 488.0)
UP = (0.0, 0.0, -60.0)
OF_EVERY_FLIGHT = [
    "schema",
    "duration_s",
    "n_frames",
    "n_fixes",
    "n_no_fix",
    "reasons",
    "error_horizontal_m",
    "availability",
    "hmi",
    "misleading",
    "nees",
    "gnss",
    "injected",
    "latency_ms",
    "epochs",
    "scenario",
    "autopilot",
    "vehicle",
    "seed",
    "failsafe",
    "pulled_m",
    "modes",
    "verdicts",
    "passed",
    "expected",
]
OF_A_REAL_ONE = ["vision_s", "error_p95_m", "rejected_share", "failsafes", "wrong_source_s", "gap_s", "version", "marks", "texts"]
FLOWN_S, JAMMED_S, DIED_S, CAME_BACK_S = 100, 10, 40, 44


def place(t_s: float, east_m: float = 0.0) -> GeoPoint:
    return geo_from_ned((5.0 * t_s, east_m, UP[2]), HOME)


def sample(t_s: float) -> RealSample:
    at, v = (5.0 * t_s, 0.0, UP[2]), (5.0, 0.0, 0.0)
    phase = "gnss" if t_s < JAMMED_S + 2 else "vision"
    return RealSample(t_s, phase, place(t_s), at, v, (1.0, 0.0, 0.0, 0.0), at, v, v, at, (0.0, 0.0), 0.2, True, 3, True)


def status(t_s: float) -> Status:
    """The daemon is off by 3 m to the east, and knows of the jamming a second after it."""
    jammed = t_s >= JAMMED_S + 1
    mode, verdict = (Mode.AIDING, Verdict.DENIED) if jammed else (Mode.SHADOW, Verdict.OK)
    cov = ((4.5, 0.0), (0.0, 4.5))
    return Status(round(t_s * 1e9), mode, verdict, (), place(t_s, 3.0), (0.0, 0.0, 0.0), cov, 1.0, 10.0, 0.3, jammed, 0)


def one_life(folder: Path, from_s: int, to_s: int) -> None:
    header = JournalHeader({}, started_ns=EPOCH_NS + from_s * 10**9, started_unix_ns=1_760_000_000 * 10**9)
    journal = JournalWriter.create(folder, header, max_bytes=10_000_000)
    for k in range(from_s * 10, to_s * 10):
        journal.command(EPOCH_NS + k * 10**8, status(k * 0.1))
    journal.close()


def flown(with_daemon: bool, round_trip_s: float = 0.01) -> Callable[..., RealLog]:
    def fly_apart(*_: object, keep: Path, **__: object) -> RealLog:
        if with_daemon:
            one_life(keep, 0, DIED_S)
            one_life(keep, CAME_BACK_S, FLOWN_S)
        samples = [sample(k * 0.1) for k in range(FLOWN_S * 10)]
        marks = [(0.0, "begun"), (float(JAMMED_S), "jam"), (float(FLOWN_S), "over")]
        return RealLog(
            version="ardupilot 4.7.0",
            samples=samples,
            marks=marks,
            failsafes=[] if with_daemon else [(20.0, "EKF Failsafe")],
            round_trips=[(float(k), round_trip_s) for k in range(FLOWN_S)],
        )

    return fly_apart


def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, *options: str) -> tuple[int, dict[str, Any]]:
    typed = typer.Typer()
    typed.command()(sim)
    monkeypatch.setattr(apart, "fly_apart", flown("--without-daemon" not in options))
    monkeypatch.setenv("VISLOC_ARDUCOPTER", sys.executable)
    arguments = ["--autopilot", "ardupilot", "--scenario", "jam", "--json", str(tmp_path / "jam.json"), *options]
    done = CliRunner().invoke(typed, arguments, catch_exceptions=False)
    return done.exit_code, json.loads((tmp_path / "jam.json").read_text(encoding="utf-8"))


def test_a_real_autopilots_flight_has_the_fields_of_every_flight(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    code, found = run(monkeypatch, tmp_path, "--seed", "4")
    assert not {*OF_EVERY_FLIGHT, *OF_A_REAL_ONE} - set(found)
    assert (found["scenario"], found["autopilot"], found["vehicle"], found["seed"]) == ("jam", "ardupilot", "copter", 4)
    assert found["error_horizontal_m"]["max"] == pytest.approx(3.0, abs=0.01)
    assert found["nees"] == pytest.approx(2.0, abs=0.02)
    assert (found["hmi"], found["misleading"], found["failsafe"], found["pulled_m"]) == (0, 0, None, 0.0)
    assert found["gnss"] == {"detected_at_s": pytest.approx(JAMMED_S + 1), "false_alarms": 0}
    assert found["modes"] == [[0.0, "shadow"], [JAMMED_S + 1, "aiding"]]
    assert found["verdicts"] == [[0.0, "ok"], [JAMMED_S + 1, "denied"]]
    assert found["passed"] is (code == 0)
    assert {"name", "value", "limit", "passed"} == set(found["expected"][0])


def test_the_epochs_of_all_lives_of_the_daemon_stand_beside(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    _, found = run(monkeypatch, tmp_path)
    with Path(found["epochs"]).open(encoding="utf-8", newline="") as file:
        times = [float(row["t_s"]) for row in csv.DictReader(file)]
    assert times == sorted(times)
    assert len(times) == (FLOWN_S - (CAME_BACK_S - DIED_S)) * 10


@pytest.mark.parametrize(("round_trip_s", "busy"), [(0.01, False), (0.3, True)])
def test_a_computer_that_was_too_busy_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, round_trip_s: float, busy: bool
) -> None:
    typed = typer.Typer()
    typed.command()(sim)
    monkeypatch.setattr(apart, "fly_apart", flown(True, round_trip_s))
    monkeypatch.setenv("VISLOC_ARDUCOPTER", sys.executable)
    done = CliRunner().invoke(typed, ["--autopilot", "ardupilot", "--scenario", "jam"], catch_exceptions=False)
    assert ("too busy for a flight at 2 times real time, which shows nothing then; remedy: end other work" in done.stderr) is busy


def test_without_the_daemon_nothing_is_expected(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    code, found = run(monkeypatch, tmp_path, "--without-daemon")
    assert (code, found["with_daemon"], found["expected"], found["passed"]) == (0, False, [], True)
    assert found["judged"] is False
    assert not {*OF_EVERY_FLIGHT, *OF_A_REAL_ONE} - set(found)
    assert found["failsafe"] == "EKF Failsafe"
    assert (found["n_frames"], found["error_horizontal_m"]["max"], found["injected"]["n"]) == (0, None, 0)


@pytest.mark.parametrize(
    ("options", "program", "why"),
    [
        (["--seed", "-1"], sys.executable, "seed is -1; remedy: give a whole number from 0 on"),
        ([], "/nowhere/arducopter", "which is no program"),
        (["--json", "/nowhere/result.json"], "/nowhere/arducopter", "its folder does not exist"),
    ],
)
def test_what_cannot_be_flown_is_refused_before_a_world_is_made(
    monkeypatch: pytest.MonkeyPatch, options: list[str], program: str, why: str
) -> None:
    typed = typer.Typer()
    typed.command()(sim)
    monkeypatch.setenv("VISLOC_ARDUCOPTER", program)
    monkeypatch.setattr(real_world, "over_its_world", lambda _: pytest.fail("a world is made"))
    with pytest.raises(ConfigError, match=why):
        CliRunner().invoke(typed, ["--autopilot", "ardupilot", "--scenario", "rendered", *options], catch_exceptions=False)
