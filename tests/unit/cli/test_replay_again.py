"""Journals of simulated flights: replayed byte for byte, and their frames localised anew (`visloc replay --rerun`)."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from visloc_companion.app.journal import Entry, JournalHeader, JournalWriter, read_frames, read_header, read_journal
from visloc_companion.cli.replay import replay
from visloc_companion.cli.rerun_source import RerunSource, compared
from visloc_companion.cli.sim import sim
from visloc_companion.config import Config, MapConfig, parse_config
from visloc_companion.errors import ConfigError, JournalError
from visloc_companion.evaluate.closed_loop import FlightWorld, fly
from visloc_companion.evaluate.record import FlightRecord, from_entries
from visloc_companion.evaluate.sim_journal import JournalChoice
from visloc_companion.maps.pack import PackMap
from visloc_companion.sim.scenarios import FLIGHTS
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.setup import FlightSetup
from visloc_companion.types import AutopilotKind, Fix, FrameRef, GeoPoint, Gnss, MapAtGnss, Status

app = typer.Typer()
app.command("replay")(replay)
app.command("sim")(sim)
PLACE = GeoPoint(47.0, 8.0, 500.0)


def run(*arguments: str | Path) -> tuple[int, str]:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output


@pytest.fixture(scope="module")
def flown(tiny_world: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The journal of ten seconds over the small world, with the frames that were localised."""
    path = tmp_path_factory.mktemp("flown") / "flight.mcap"
    world = FlightWorld(tiny_world.pack, PackMap.open(tiny_world.pack), Scene.load(tiny_world.ortho, tiny_world.dsm))
    scenario = replace(FLIGHTS["jam"], duration_s=10.0, frame_rate_hz=2.0)
    setup = FlightSetup(scenario, world.area(), AutopilotKind.ARDUPILOT, "copter", 1)
    fly(setup, world, method="gradient", kept=JournalChoice(path, frames=True))
    return path


def figures(journal: Path, folder: Path, *arguments: str | Path) -> dict[str, Any]:
    code, text = run("replay", journal, "--json", folder / "figures.json", *arguments)
    assert code == 0, text
    found: dict[str, Any] = json.loads((folder / "figures.json").read_text())
    return found


def test_a_simulated_flight_is_replayed_byte_for_byte(flown: Path, tmp_path: Path) -> None:
    found = figures(flown, tmp_path)
    assert found["commands"]["identical"] is True
    assert found["commands"]["n_recorded"] > 20
    assert found["n_fixes"] > 5


@pytest.mark.parametrize(
    ("share", "elsewhere", "code", "words"),
    [
        (1e-12, True, 0, "commands are those of the flight but for rounding: numbers are 1e-12 apart"),
        (1e-12, False, 1, "commands are those of the flight but for rounding: numbers are 1e-12 apart"),
        (1e-6, True, 1, "differs from the flight, first at command"),
    ],
)
def test_another_computer_may_round_otherwise(
    share: float, elsewhere: bool, code: int, words: str, flown: Path, tmp_path: Path
) -> None:
    versions = read_header(flown).versions
    journal = tmp_path / "flown.mcap"
    journal.write_bytes(_copied(flown, versions | ({"machine": "other64"} if elsewhere else {}), share))
    got, text = run("replay", journal, "--json", tmp_path / "figures.json")
    commands = json.loads((tmp_path / "figures.json").read_text())["commands"]
    assert (got, words in " ".join(text.split())) == (code, True), text
    assert (f"machine other64 (here {versions['machine']})" in " ".join(text.split())) is elsewhere
    assert commands["identical"] is False
    assert commands["largest_difference"] == pytest.approx(share, rel=0.01)


def test_frames_localised_anew_are_where_they_were(flown: Path, tmp_path: Path) -> None:
    found = figures(flown, tmp_path, "--rerun", "--out", tmp_path / "report")
    again = found["rerun"]
    assert again["method"] == "gradient"
    assert again["n_fixes"] == again["n_fixes_in_flight"] == again["n_frames_of_both"] == found["n_fixes"]
    assert again["apart_p95_m"] == pytest.approx(0.0, abs=0.02)  # the answers arrive at the median of the flight's delays
    assert again["n_not_recorded"] == 0
    assert (tmp_path / "report" / "report.html").is_file()


def test_a_configuration_without_a_lens_is_not_that_of_the_flight() -> None:
    """Its frames were localised as those of a lens of 500 px."""
    told = parse_config({"camera": {"width_px": 640, "height_px": 480, "fx_px": 554.0}})
    source = RerunSource(Path("flight.mcap"), told, Path("own.toml"), Path("pack"), salvage=False)
    with pytest.raises(ConfigError, match=r"own\.toml: camera: fy_px, cx_px, cy_px not stated; remedy: write the calibration"):
        source._effective(JournalHeader({}))
    of_the_flight = JournalHeader(Config(map=MapConfig(pack="pack")).model_dump(mode="json"))
    assert RerunSource(Path("flight.mcap"), None, Path("flight.mcap"), None, salvage=False)._effective(of_the_flight).map.pack


def test_another_configuration_is_flown_with_another_map(flown: Path, tiny_world: Any, tmp_path: Path) -> None:
    configuration = read_header(flown).configuration
    pack = Path(configuration["map"]["pack"])
    assert pack == tiny_world.pack
    own = tmp_path / "own.toml"
    camera = "\n".join(f"{name} = {value}" for name, value in configuration["camera"].items() if isinstance(value, int | float))
    own.write_text(f'[camera]\n{camera}\n[localiser]\nmethod = "ncc"\n')
    with pytest.raises(ConfigError, match=r"own\.toml: names no map; remedy: give the pack with --map"):
        run("replay", flown, "--rerun", "--config", own)
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(own.read_text().replace("cx_px = ", "cx_px = 9"))
    with pytest.raises(ConfigError, match=r"wrong\.toml: camera\.cx_px: 9.* lies outside of the picture"):
        run("replay", flown, "--rerun", "--config", wrong, "--map", pack)
    found = figures(flown, tmp_path, "--rerun", "--config", own, "--map", pack)
    again = found["rerun"]
    assert (again["method"], again["map"]) == ("ncc", str(pack))
    assert 5 < again["n_frames_of_both"] <= again["n_fixes"]
    assert 0.01 < again["apart_median_m"] < 5.0  # another method: not the same place, but within a few pixels


def test_why_no_frame_was_placed_is_told(flown: Path, tiny_world: Any, tmp_path: Path) -> None:
    """Of frames of another size than the configuration's none is: 0 fixes alone name no fault."""
    camera = {key: value for key, value in read_header(flown).configuration["camera"].items() if isinstance(value, int | float)}
    size = (camera["width_px"], camera["height_px"])
    camera |= {"width_px": 2 * size[0], "height_px": 2 * size[1], "cx_px": size[0], "cy_px": size[1]}
    own = tmp_path / "own.toml"
    lines = "\n".join(f"{name} = {value}" for name, value in camera.items())
    own.write_text(f'[camera]\n{lines}\n[localiser]\nmethod = "ncc"\n')
    code, text = run("replay", flown, "--rerun", "--config", own, "--map", tiny_world.pack)
    told = " ".join(text.split())
    assert code == 0
    assert re.search(rf"No frame was placed: (\d+) of \1 are bad_frame \(.*{size[0]} ?x ?{size[1]}.*\)\.", told), told


def test_what_the_flights_map_said_before_arming_is_asked_of_the_map_of_now(flown: Path, tiny_world: Any, tmp_path: Path) -> None:
    """A vehicle off its map had GNSS called false on the ground, and again where the right map was given."""
    entries, journal = list(read_journal(flown)), tmp_path / "off.mcap"
    place = next(entry.event.place for entry in entries if isinstance(entry.event, Gnss))
    writer = JournalWriter(journal.open("wb"), read_header(flown))
    said = MapAtGnss(entries[-1].now_ns, place, inside=False, surface_amsl_m=None)
    for entry in [*entries, Entry(entries[-1].now_ns, said, None)]:
        writer.entry(entry)
        writer.wait(1000)
    for number, pixels in islice(read_frames(flown), 1):
        writer.frame(entries[-1].now_ns, FrameRef(0, 0, number, 0, pixels.shape[1], pixels.shape[0], 3), pixels)
    writer.close()
    source = RerunSource(journal, None, journal, tiny_world.pack, salvage=False)
    heard: list[MapAtGnss] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("visloc_companion.cli.rerun_source.from_entries", lambda found: _kept(found, heard))
        source.record()
    (asked,) = heard
    assert (asked.t_rx_ns, asked.place, asked.inside) == (said.t_rx_ns, place, True)
    assert asked.surface_amsl_m is not None


def _kept(entries: list[Entry], heard: list[MapAtGnss]) -> FlightRecord:
    heard += [entry.event for entry in entries if isinstance(entry.event, MapAtGnss)]
    return from_entries(entries)


def test_a_journal_without_frames_and_a_log_are_refused(flown: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"--rerun: is for journals"):
        (tmp_path / "flight.tlog").write_bytes(b"")
        run("replay", tmp_path / "flight.tlog", "--rerun")
    assert next(read_frames(flown), None) is not None
    bare = tmp_path / "bare.mcap"
    bare.write_bytes(_without_frames(flown))
    with pytest.raises(JournalError, match=r"bare\.mcap: holds no frames; remedy: record them: journal\.record_frames"):
        run("replay", bare, "--rerun")


def _without_frames(journal: Path) -> bytes:
    return _copied(journal, read_header(journal).versions, 0.0)


def _copied(journal: Path, versions: dict[str, str], share: float) -> bytes:
    """Without frames, as if versions had flown that make protection levels larger by a share."""
    stream = BytesIO()
    stream.close = lambda: None  # type: ignore[method-assign]
    writer = JournalWriter(stream, replace(read_header(journal), versions=versions))
    for entry in read_journal(journal):
        if share and isinstance(entry.command, Status) and entry.command.protection_level_m is not None:
            larger = replace(entry.command, protection_level_m=entry.command.protection_level_m * (1 + share))
            entry = replace(entry, command=larger)  # noqa: PLW2901
        writer.entry(entry)
        writer.wait(100)
    writer.close()
    return stream.getvalue()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--scenario", "jam", "--record-frames"), "--record-frames goes with --journal"),
        (("--campaign", "scenarios", "--journal", "a.mcap"), "--journal keeps one flight"),
        (("--scenario", "jam", "--without-daemon", "--journal", "a.mcap"), "--journal keeps what the daemon does"),
        (("--scenario", "jam", "--journal", "/nowhere/a.mcap"), "/nowhere/a.mcap"),
        (("--autopilot", "px4", "--scenario", "jam", "--journal", "a.mcap"), "--journal means nothing with --autopilot px4"),
    ],
)
def test_a_journal_that_cannot_be_is_refused_before_the_flight(arguments: Sequence[str], words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        run("sim", *arguments)
    assert words in str(caught.value)


def test_fixes_are_compared_frame_by_frame() -> None:
    def fix(frame: int, north_deg: float, method: str = "deep") -> Entry:
        place = replace(PLACE, lat_deg=PLACE.lat_deg + north_deg)
        level = (1.0, 0.0, 0.0, 0.0)
        return Entry(frame, Fix(0, 0, frame, frame, method, place, level, ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.01, 0.0, 1.0), None)

    old, new = [fix(1, 0.0), fix(2, 0.0), fix(4, 0.0, "structure")], [fix(1, 1e-5), fix(2, 3e-5), fix(3, 0.0), fix(4, 0.0)]
    found = compared(old, new)
    assert (found["n_fixes_in_flight"], found["n_fixes"], found["n_frames_of_both"]) == (3, 4, 2)
    assert found["apart_median_m"] == pytest.approx(2e-5 * 111_170, rel=1e-3)
