"""`visloc sim`: flights, campaigns, their files and exit codes."""

from __future__ import annotations

import csv
import errno
import json
import os
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from visloc_companion.cli.sim import sim
from visloc_companion.cli.sim_result import write_result
from visloc_companion.errors import ConfigError, MapError
from visloc_companion.evaluate import campaign, closed_loop, flight_area, metrics, report
from visloc_companion.evaluate.campaign import FlightSpec, FlownSpec
from visloc_companion.evaluate.closed_loop import FlightWorld
from visloc_companion.evaluate.record import from_entries
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare import world
from visloc_companion.sim.flight import Eyes
from visloc_companion.sim.real.scenarios import NAMES
from visloc_companion.sim.scenarios import SCENARIOS
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.setup import FlightSetup

app = typer.Typer()
app.command()(sim)
MakeEyes = Callable[..., Eyes]


def run(*arguments: str | Path) -> tuple[int, str]:
    """Exit code and output; errors of the package are raised."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout


def flown_by_hand(number: int, spec: FlightSpec, *, passed: bool = True) -> FlownSpec:
    figures = {"error_horizontal_m": {"median": 1.0, "max": 2.0}, "pulled_m": 0.0, "gnss": {"detected_at_s": 31.0}}
    more = {"judged": True, "passed": passed, "failsafe": None, "availability": 1.0, "n_fixes": 9, "hmi": 0, "same_image": False}
    flown = {**asdict(spec), **figures, **more, "pack": "", "camera_ortho": "", "camera_dsm": ""}
    return FlownSpec(number, flown, np.full(3, 5.0), np.full(3, 1.0))


@pytest.fixture
def places(tiny_world: Any) -> list[str]:
    return ["--map", str(tiny_world.pack), "--camera-ortho", str(tiny_world.ortho), "--camera-dsm", str(tiny_world.dsm)]


def test_beside_a_pipe_there_are_no_epochs(tmp_path: Path) -> None:
    """`--json /dev/stdout` ended with exit code 2 after the flight, or left /dev/stdout-epochs.csv."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    end = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        write_result(from_entries([]), {"passed": True}, pipe)
        assert json.loads(os.read(end, 4096)) == {"passed": True, "epochs": None}
    finally:
        os.close(end)
    assert list(tmp_path.iterdir()) == [pipe]


def test_the_list_names_scenarios_and_campaigns() -> None:
    code, text = run("--list")
    assert code == 0
    assert [line.split()[0] for line in text.splitlines()] == [*SCENARIOS, "demo", "long_jam", "scenarios", "vehicles"]


@pytest.mark.parametrize(
    ("autopilot", "vehicle", "lacking"),
    [
        ("ardupilot", "copter", {"rendered_usual_drag"}),
        ("px4", "copter", {"slow_drag"}),
        ("ardupilot", "plane", {"rendered_usual_drag", "no_gnss_at_boot"}),
    ],
)
def test_the_list_of_a_real_autopilot_names_what_it_can_fly(autopilot: str, vehicle: str, lacking: set[str]) -> None:
    listed = CliRunner().invoke(app, ["--list", "--autopilot", autopilot, "--vehicle", vehicle])
    code, text = listed.exit_code, listed.stdout
    assert code == 0
    whole = listed.stderr.splitlines()
    assert {line.split(": ")[1].split()[0] for line in whole if line.startswith("not flown by ")} == lacking, "and why"
    assert all(line.endswith(")") for line in whole[:-1])
    assert whole[-1] == "where nothing else is said, GNSS is jammed at 60 s, and 140 s are flown on vision"
    assert [line.split()[0] for line in text.splitlines()] == [name for name in NAMES if name not in lacking]
    assert "jam                   360 s  GNSS is jammed at 60 s for good; 300 s on vision" in text


def test_the_list_of_an_autopilot_that_there_is_not_is_refused() -> None:
    with pytest.raises(ConfigError, match="no simulator of betaflight"):
        run("--list", "--autopilot", "betaflight")


@pytest.mark.usefixtures("short_jam")
def test_a_good_flight_is_told_judged_and_written(
    places: list[str], tmp_path: Path, oracle_eyes: MakeEyes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(closed_loop, "eyes_over", lambda *_: oracle_eyes())
    files = "--json", tmp_path / "jam.json", "--report", tmp_path / "jam.html"
    code, text = run("--scenario", "jam", "--dialect", "px4", "--seed", "3", *places, *files)
    assert code == 0
    assert text.startswith("PASS jam px4 copter seed 3: error median ")
    assert text.count("\n  ok   ") == text.count("(limit ") >= 12
    result = json.loads((tmp_path / "jam.json").read_text(encoding="utf-8"))
    assert (result["scenario"], result["autopilot"], result["passed"]) == ("jam", "built-in", True)
    assert result["epochs"] == str(tmp_path / "jam-epochs.csv")
    with (tmp_path / "jam-epochs.csv").open(encoding="utf-8", newline="") as file:
        epochs = list(csv.DictReader(file))
    assert len(epochs) == 300
    assert epochs[-1]["verdict"] == "denied"
    page = (tmp_path / "jam.html").read_text(encoding="utf-8")
    assert "PASS" in page
    assert "With the daemon" in page, "the flight without it is shown beside"
    assert "data:image/jpeg" in page


@pytest.mark.usefixtures("short_jam")
def test_over_the_maps_own_orthophoto_the_figures_say_same_image(
    tiny_world: Any, tmp_path: Path, oracle_eyes: MakeEyes, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[Scene] = []

    def eyes(setup: FlightSetup, world: FlightWorld, method: str) -> Eyes:
        seen.append(world.scene)
        return oracle_eyes()

    monkeypatch.setattr(closed_loop, "eyes_over", eyes)
    files = "--json", tmp_path / "jam.json", "--report", tmp_path / "jam.html"
    code, text = run("--scenario", "jam", "--map", tiny_world.pack, *files)
    assert code == 0
    assert "seed 1, same image: error" in text
    assert json.loads((tmp_path / "jam.json").read_text(encoding="utf-8"))["same_image"] is True
    assert ", same image</" in (tmp_path / "jam.html").read_text(encoding="utf-8")
    reference = PackMap.open(tiny_world.pack, verify_hashes=False)
    own = Scene.load(tiny_world.pack / reference.manifest.ortho.file)
    np.testing.assert_array_equal(seen[0].pixels, own.pixels)


@pytest.mark.usefixtures("short_jam")
def test_a_flight_with_the_camera_on_a_gimbal_is_told_as_one(
    places: list[str], tmp_path: Path, oracle_eyes: MakeEyes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(closed_loop, "eyes_over", lambda *_: oracle_eyes())
    files = "--json", tmp_path / "jam.json", "--report", tmp_path / "jam.html"
    code, text = run("--scenario", "jam", "--gimbal", *places, *files)
    assert code == 0
    assert text.startswith("PASS jam ardupilot copter seed 1, gimbal: error median ")
    assert json.loads((tmp_path / "jam.json").read_text(encoding="utf-8"))["gimbal"] is True
    assert "jam: ardupilot copter, gimbal, deep</" in (tmp_path / "jam.html").read_text(encoding="utf-8")


@pytest.mark.usefixtures("short_jam")
def test_a_flight_that_fails_exits_with_1(
    places: list[str], tmp_path: Path, oracle_eyes: MakeEyes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(closed_loop, "eyes_over", lambda *_: oracle_eyes(misses=1.0))
    code, text = run("--scenario", "jam", *places, "--json", tmp_path / "jam.json")
    assert code == 1
    assert text.startswith("FAIL jam ardupilot copter")
    assert "  FAIL failsafe: " in text
    result = json.loads((tmp_path / "jam.json").read_text(encoding="utf-8"))
    assert result["passed"] is False
    assert result["failsafe"]


@pytest.mark.usefixtures("short_jam")
def test_without_the_daemon(places: list[str], tmp_path: Path) -> None:
    files = "--json", tmp_path / "jam.json", "--report", tmp_path / "jam.html"
    code, text = run("--scenario", "jam", "--without-daemon", *places, *files)
    assert code == 0
    assert "failsafe EKF Failsafe" in text
    assert "None" not in text, "of what only the daemon has an estimate"
    result = json.loads((tmp_path / "jam.json").read_text(encoding="utf-8"))
    assert (result["with_daemon"], result["n_frames"], result["expected"]) == (False, 0, [])
    assert "NO GATE" in (tmp_path / "jam.html").read_text(encoding="utf-8")


def test_every_scenario_is_seen_on_its_date(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a map of one's own it is the procedural world, on the date that the scenario names."""
    made = world.ProceduralWorld(tmp_path / "pack", tmp_path / "flight.tif", tmp_path / "flight-dsm.tif")
    monkeypatch.setattr(world, "procedural_world", lambda *_, **__: made)
    monkeypatch.setattr(world, "_make_date", lambda seed, size_m, date, folder: (folder / date).mkdir())
    flown: list[FlightSpec] = []

    def fly_spec(spec: FlightSpec, *_: object) -> None:
        flown.append(spec)
        raise MapError("enough")

    monkeypatch.setattr(campaign, "fly_spec", fly_spec)
    for arguments in (["--scenario", "jam"], ["--scenario", "season_change", "--without-structure"]):
        with pytest.raises(MapError, match="enough"):
            run(*arguments)
    assert [(spec.camera_ortho, spec.structure) for spec in flown] == [
        (tmp_path / "flight.tif", True),
        (tmp_path / "snow" / "ortho.tif", False),
    ]


@pytest.mark.parametrize(("passed", "code"), [(2, 0), (1, 1)])
def test_a_campaign_is_flown_told_and_written(
    passed: int, code: int, places: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []

    def fly_campaign(specs: list[FlightSpec], jobs: int) -> Iterator[FlownSpec]:
        asked.append((specs, jobs))
        yield from (flown_by_hand(k, spec, passed=k < passed) for k, spec in enumerate(specs))

    monkeypatch.setattr(campaign, "fly_campaign", fly_campaign)
    path = tmp_path / "two.json"
    path.write_text(json.dumps([{"scenario": "jam"}, {"scenario": "slow_drag", "vehicle": "plane"}]), encoding="utf-8")
    told = run("--campaign", path, "--dialect", "px4", *places, "--json", tmp_path / "out.json", "--jobs", "2")
    assert told[0] == code
    [(specs, jobs)] = asked
    assert jobs == 2
    assert [(spec.scenario, spec.vehicle, spec.dialect) for spec in specs] == [
        ("jam", "copter", "px4"),
        ("slow_drag", "plane", "px4"),
    ]
    assert {str(spec.pack) for spec in specs} == {places[1]}
    lines = told[1].splitlines()
    assert [line.split()[0] for line in lines[:2]] == ["PASS", "PASS" if passed == 2 else "FAIL"]
    assert lines[2].startswith(f"flights=2 passed={passed} ")
    written = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    assert (written["complete"], written["asked"], written["totals"]["passed"]) == (True, 2, passed)


@pytest.mark.parametrize("why", [KeyboardInterrupt(), MapError("is damaged"), RuntimeError("of one flight")], ids=repr)
def test_a_campaign_that_ends_early_writes_what_was_flown(
    why: BaseException, places: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fly_campaign(specs: list[FlightSpec], jobs: int) -> Iterator[FlownSpec]:
        yield flown_by_hand(1, specs[1])
        yield flown_by_hand(0, specs[0])
        raise why

    monkeypatch.setattr(campaign, "fly_campaign", fly_campaign)
    path, out = tmp_path / "three.json", tmp_path / "out.json"
    path.write_text(json.dumps([{"scenario": "jam", "seed": seed} for seed in (1, 2, 3)]), encoding="utf-8")
    ended = CliRunner().invoke(app, ["--campaign", str(path), *places, "--json", str(out)])
    assert ended.exit_code != 0
    written = json.loads(out.read_text(encoding="utf-8"))
    assert (written["complete"], written["asked"], written["totals"]["flights"]) == (False, 3, 2)
    assert [flight["seed"] for flight in written["flights"]] == [1, 2]
    assert "INCOMPLETE, of 3 flights: flights=2 " in ended.stdout


@pytest.mark.usefixtures("short_jam")
def test_flights_are_kept_when_their_words_find_no_reader(
    places: list[str], tmp_path: Path, oracle_eyes: MakeEyes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`visloc sim ... --json FILE | head -1`."""

    def gone(*_: object, **__: object) -> None:
        raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE))

    monkeypatch.setattr("typer.echo", gone)
    monkeypatch.setattr(closed_loop, "eyes_over", lambda *_: oracle_eyes())
    monkeypatch.setattr(campaign, "fly_campaign", lambda specs, jobs: iter([flown_by_hand(0, specs[0])]))
    (tmp_path / "one.json").write_text(json.dumps([{"scenario": "jam"}]), encoding="utf-8")
    for asked in (["--scenario", "jam", "--report", tmp_path / "jam.html"], ["--campaign", tmp_path / "one.json"]):
        out = tmp_path / f"{asked[0]}.json"
        ended = CliRunner().invoke(app, [*map(str, asked), *places, "--json", str(out)])
        assert ended.exit_code == 1
        assert json.loads(out.read_text(encoding="utf-8"))
    assert (tmp_path / "jam.html").exists()


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ([], "name either --scenario or --campaign"),
        (["--scenario", "jam", "--campaign", "scenarios"], "name either --scenario or --campaign"),
        (["--scenario", "picnic"], "unknown scenario 'picnic'"),
        (["--scenario", "jam", "--dialect", "betaflight"], "unknown dialect 'betaflight'"),
        (["--scenario", "jam", "--vehicle", "boat"], "unknown vehicle 'boat'"),
        (["--scenario", "jam", "--method", "guess"], "unknown method 'guess'"),
        (["--scenario", "jam", "--autopilot", "px4", "--vehicle", "boat"], "there is no simulator of px4 with a boat"),
        (["--scenario", "picnic", "--autopilot", "px4"], "there is no flight 'picnic' against a real simulator"),
        (["--scenario", "jam", "--autopilot", "ardupilot"], r"VISLOC_ARDUCOPTER names nothing, which is no program"),
        (["--scenario", "jam", "--jobs", "3"], "--jobs means nothing with --scenario.*; remedy: leave it out, or .*--campaign"),
        (["--campaign", "scenarios", "--report", "report.html"], "--report shows one flight"),
        (["--campaign", "nothing.json"], "is no campaign"),
        (["--campaign", "scenarios", "--vehicle", "plane"], "--vehicle is settled by the campaign scenarios"),
        (["--campaign", "vehicles", "--seed", "7"], "--seed is settled by the campaign vehicles"),
        (["--autopilot", "px4", "--campaign", "scenarios"], "--campaign means nothing with --autopilot px4"),
        (["--autopilot", "ardupilot", "--scenario", "jam", "--map", "pack"], "--map means nothing with --autopilot ardupilot"),
        (["--autopilot", "px4", "--scenario", "jam", "--report", "x.html"], "--report means nothing with --autopilot px4"),
        (["--autopilot", "px4", "--scenario", "jam", "--without-structure"], "--without-structure means nothing"),
        (["--autopilot", "px4", "--scenario", "jam", "--gimbal"], "--gimbal means nothing with --autopilot px4"),
        (["--scenario", "jam", "--json", "none/result.json"], "its folder does not exist"),
        (["--scenario", "jam", "--camera-ortho", "ortho.tif"], "--camera-ortho goes with --map"),
        (["--scenario", "jam", "--camera-dsm", "dsm.tif"], "--camera-dsm goes with --map"),
        (["--scenario", "jam", "--json", "."], "is a folder.*name a file for --json"),
        (["--scenario", "jam", "--report", "."], "is a folder.*name a file for --report"),
        (["--scenario", "jam", "--seed", "-1"], "seed is -1"),
    ],
)
def test_what_cannot_be_flown_is_refused_before_any_work(
    arguments: list[str], complaint: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Before the procedural world is made, which takes half a minute."""

    def never(*_: object, **__: object) -> None:
        raise AssertionError("the world was made")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("VISLOC_ARDUCOPTER", "nothing")
    monkeypatch.setattr(world, "procedural_world", never)
    with pytest.raises(ConfigError, match=complaint):
        run(*arguments)


@pytest.mark.usefixtures("short_jam")
@pytest.mark.parametrize("option", ["--json", "--report"])
def test_a_full_disk_is_told_with_the_option_after_the_flight_was_judged(
    option: str, places: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A traceback and exit code 1, which means a failed gate, once took the place of the verdict."""

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(metrics, "write_epochs", full)
    monkeypatch.setattr(report, "write_flight_report", full)
    ended = CliRunner().invoke(app, ["--scenario", "jam", "--without-daemon", *places, option, str(tmp_path / "out")])
    with pytest.raises(ConfigError, match=rf"cannot be written: .*No space left.*name a writable file for {option}"):
        raise ended.exception or AssertionError("nothing was raised")
    assert ended.stdout.startswith("FLOWN jam ardupilot copter seed 1")


def test_a_map_that_is_too_small_is_refused(tiny_world: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flight_area, "corners_reach_m", lambda *_: 100.0)
    with pytest.raises(MapError, match="too little for a flight"):
        run("--scenario", "jam", "--without-daemon", "--map", tiny_world.pack, "--camera-ortho", tiny_world.ortho)
