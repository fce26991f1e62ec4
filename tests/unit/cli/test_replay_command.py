"""`visloc replay` on logs, folders and journals: figures, files, gates and clear refusals."""

from __future__ import annotations

import csv
import json
import os
import re
import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import typer
from pymavlink.dialects.v20 import ardupilotmega as mavlink2
from typer.testing import CliRunner

from visloc_companion.app.journal import JournalHeader, JournalWriter
from visloc_companion.app.settings import core_settings
from visloc_companion.cli.replay import replay
from visloc_companion.config import Config
from visloc_companion.core.navigator import Navigator
from visloc_companion.errors import ConfigError, JournalError, LogError, MapError
from visloc_companion.types import Attitude, Tick

CHUNK = 6
"""The MCAP record that holds others; the first of a journal, with its header, is within the first thousand bytes."""
UNIX_US = 1_600_000_000_000_000
app = typer.Typer()
app.command()(replay)


def run(*arguments: str | Path) -> tuple[int, str]:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output


@pytest.fixture
def log(tmp_path: Path) -> Path:
    mav = mavlink2.MAVLink(None, srcSystem=1, srcComponent=1)
    pieces = []
    for k in range(100):
        boot, lat = 60_000 + 100 * k, round((47.4 + k * 4.5e-6) * 1e7)
        for message in (
            mav.heartbeat_encode(2, 3, 0x81, 0, 4),
            mav.attitude_encode(boot, 0, 0, 0, 0, 0, 0),
            mav.gps_raw_int_encode(boot * 1000, 3, lat, 85_500_000, 540_000, 90, 90, 500, 0, 14),
            mav.global_position_int_encode(boot, lat, 85_500_000, 540_000, 50_000, 500, 0, 0, 0),
        ):
            pieces.append(struct.pack(">Q", UNIX_US + 100_000 * k) + bytes(message.pack(mav)))
    path = tmp_path / "telemetry.tlog"
    path.write_bytes(b"".join(pieces))
    return path


def test_a_log_gives_figures_files_and_a_report(log: Path, tmp_path: Path) -> None:
    out, figures = tmp_path / "out", tmp_path / "figures.json"
    code, text = run(log, "--out", out, "--json", figures)
    assert code == 0
    assert "GNSS: denied from 0.0 s, ok from" in text
    result = json.loads(figures.read_text())
    assert result["schema"] == 1
    assert result["duration_s"] == pytest.approx(9.9, abs=0.1)
    assert result["autopilot"] == "ardupilot"
    assert result["hmi"] is None
    assert result["verdicts"][-1][1] == "ok"
    rows = list(csv.DictReader(Path(result["epochs"]).read_text().splitlines()))
    assert len(rows) == pytest.approx(99, abs=1)
    assert "Replay of telemetry.tlog" in (out / "report.html").read_text()


def test_truth_in_a_folder_makes_errors_and_gates(log: Path, tmp_path: Path) -> None:
    rows = [f"{60_000_000 + 100_000 * k},{47.4 + k * 4.5e-6},8.55,540" for k in range(100)]
    (tmp_path / "truth.csv").write_text("t_us,lat_deg,lon_deg,h_amsl_m\n" + "\n".join(rows))
    figures = tmp_path / "figures.json"
    code, text = run(tmp_path, "--json", figures, "--gate", "hmi=0,max_m<=5,false_alarms=0")
    assert code == 0
    assert text.count("ok: ") == 3
    assert json.loads(figures.read_text())["error_horizontal_m"]["max"] < 5
    code, text = run(tmp_path, "--gate", "hmi=0,n_fixes>=1")
    assert code == 1
    assert "FAILED: n_fixes >= 1 (is 0)" in text


def test_gates_on_what_is_undefined_fail(log: Path) -> None:
    code, text = run(log, "--gate", "p95_m<=100")
    assert code == 1
    assert (
        "FAILED: p95_m <= 100 (there is none: it comes of a truth beside the flight, of fixes, positions sent or an alarm)"
        in text
    )


@pytest.mark.parametrize(
    ("arguments", "kind", "words"),
    [
        (["--gate", "p95_mm<3"], ConfigError, "--gate: 'p95_mm' is no figure"),
        (["--speed", "fast"], ConfigError, "--speed: 'fast' is no speed"),
        (["--speed", "0"], ConfigError, "--speed"),
        (["--salvage"], ConfigError, "--salvage: is for journals"),
        (["--map", "nowhere"], MapError, "nowhere"),
        (["--config", "nowhere.toml"], ConfigError, "nowhere.toml"),
        (["--out", "/proc/nowhere/out"], ConfigError, "/proc/nowhere/out"),
    ],
)
def test_wrong_arguments_are_named(log: Path, arguments: list[str], kind: type[Exception], words: str) -> None:
    with pytest.raises(kind) as caught:
        run(log, *arguments)
    assert words in str(caught.value)


@pytest.mark.parametrize("limit", ["nan", "inf", "1e400", "0"])
def test_an_alert_limit_that_is_none_is_refused(log: Path, tmp_path: Path, limit: str) -> None:
    """An infinite one would find nothing hazardous, and is no number of JSON."""
    (tmp_path / "truth.csv").write_text("t_us,lat_deg,lon_deg,h_amsl_m\n60000000,47.4,8.55,540\n61000000,47.4,8.55,540\n")
    code, text = run(tmp_path, "--alert-limit", limit, "--json", tmp_path / "figures.json")
    assert code == 2
    assert "--alert-limit" in text


@pytest.mark.parametrize(
    ("suffix", "option", "kind", "words"),
    [
        ("tlog", "--system-id", LogError, r"no autopilot of system 2; remedy: name one that is there: 1"),
        ("tlog", "--boot", LogError, r"is a telemetry log: its boots follow each other.*leave --boot out"),
        ("bin", "--system-id", LogError, r"no telemetry log: it is of one vehicle; remedy: leave --system-id out"),
        ("mcap", "--system-id", ConfigError, r"are for logs, not for journals"),
    ],
)
def test_a_choice_that_a_flight_does_not_offer_is_refused(
    log: Path, tmp_path: Path, suffix: str, option: str, kind: type[Exception], words: str
) -> None:
    flight = tmp_path / f"flight.{suffix}"
    flight.write_bytes(log.read_bytes() if suffix == "tlog" else b"\xa3\x95\x80 a log")
    with pytest.raises(kind, match=words):
        run(flight, option, "2")


def test_the_vehicle_of_a_system_id_is_replayed(log: Path, tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    assert run(log, "--system-id", "1", "--json", figures)[0] == 0
    assert json.loads(figures.read_text())["duration_s"] == pytest.approx(9.9, abs=0.1)


@pytest.mark.parametrize("time_base", ["autopilot_boot", "offset"])
def test_a_lens_that_is_none_is_named_with_its_file(log: Path, tmp_path: Path, tiny_world: Any, time_base: str) -> None:
    """Millimetres for pixels."""
    cv2.imwrite(str(tmp_path / "f0.png"), np.full((48, 64, 3), 90, np.uint8))
    (tmp_path / "frames.csv").write_text("t_us,file\n61000000,f0.png\n")
    (tmp_path / "camera.toml").write_text(
        "width_px = 64\nheight_px = 48\nfx_px = 0.2\nfy_px = 50.0\ncx_px = 31.5\ncy_px = 23.5\n" + f'time_base = "{time_base}"\n'
    )
    with pytest.raises(ConfigError, match=r"/camera\.toml: camera\.fx_px: 0\.2 px are a view of 179.*; remedy: write the focal"):
        run(log.parent, "--map", tiny_world.pack)


def test_wrong_flights_are_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="is not there"):
        run(tmp_path / "none.tlog")
    with pytest.raises(LogError, match="needs one telemetry file"):
        run(tmp_path)
    (tmp_path / "a.mcap").write_bytes(b"no journal")
    with pytest.raises(JournalError, match=r"a\.mcap"):
        run(tmp_path / "a.mcap")


@pytest.mark.parametrize("name", ["epochs.csv", "report.html"])
def test_results_that_cannot_be_written_are_named(log: Path, tmp_path: Path, name: str) -> None:
    (tmp_path / "out" / name).mkdir(parents=True)
    with pytest.raises(ConfigError, match=rf"cannot be written: .*{re.escape(name)}.*writable folder for --out"):
        run(log, "--out", tmp_path / "out")


@pytest.mark.parametrize("lost", ["out", "json"])
def test_a_full_disk_costs_no_figures(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lost: str) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    if lost == "out":
        monkeypatch.setattr("visloc_companion.evaluate.metrics.write_epochs", full)
    else:
        put = Path.replace
        monkeypatch.setattr(Path, "replace", lambda at, to: full() if Path(to).name == "r.json" else put(at, to))
    arguments = [str(log), "--out", str(tmp_path / "out"), "--json", str(tmp_path / "r.json")]
    ended = CliRunner().invoke(app, arguments)
    with pytest.raises(ConfigError, match=rf"cannot be written: .*No space left.*for --{lost}"):
        raise ended.exception or AssertionError("nothing was raised")
    assert "GNSS: denied from 0.0 s" in ended.stdout
    assert ("report: " in ended.stdout) == (lost == "json") == (not (tmp_path / "r.json").exists())
    if lost == "out":
        assert json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))["epochs"] is None


def test_a_name_that_is_no_utf8_costs_no_results(log: Path, tmp_path: Path) -> None:
    """As an old disk or another system left it; and the terminal shows Latin 1."""
    flight = os.fsencode(log.parent) + b"/fl\xfcg \xe2\x89\xa4.tlog"
    log.rename(os.fsdecode(flight))
    command = [sys.executable, "-c", "from visloc_companion.cli.main import main; main()", "replay", flight]
    environment = os.environ | {"PYTHONIOENCODING": "latin-1"}
    asked = [*command, "--out", tmp_path / "out", "--json", tmp_path / "r.json"]
    ended = subprocess.run(asked, capture_output=True, env=environment, check=False)
    assert (ended.returncode, ended.stderr.count(b"Traceback")) == (0, 0)
    assert b"fl\\udcfcg \\u2264.tlog: " in ended.stdout
    assert json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))["flight"] == os.fsdecode(flight)
    assert "Replay of fl\\udcfcg ≤.tlog" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_a_json_file_without_folder_is_refused_before_the_replay(tmp_path: Path) -> None:
    (tmp_path / "none.tlog").write_bytes(b"no log")
    with pytest.raises(ConfigError, match="its folder does not exist"):
        run(tmp_path / "none.tlog", "--json", tmp_path / "nowhere" / "x.json")


def test_the_json_file_may_lie_in_the_folder_of_results(log: Path, tmp_path: Path) -> None:
    run(log, "--out", tmp_path / "a" / "out", "--json", tmp_path / "a" / "out" / "r.json")
    assert sorted(path.name for path in (tmp_path / "a" / "out").iterdir()) == ["epochs.csv", "r.json", "report.html"]
    with pytest.raises(ConfigError, match="is a folder; remedy: name a file for --json"):
        run(log, "--out", tmp_path / "b", "--json", tmp_path / "b")


def test_a_log_without_attitude_says_so(tmp_path: Path) -> None:
    mav = mavlink2.MAVLink(None, srcSystem=1, srcComponent=1)
    sent = [
        mav.heartbeat_encode(2, 3, 0x81, 0, 4),
        mav.global_position_int_encode(1000, 474_000_000, 85_500_000, 0, 0, 0, 0, 0, 0),
    ]
    (tmp_path / "a.tlog").write_bytes(b"".join(struct.pack(">Q", UNIX_US) + bytes(message.pack(mav)) for message in sent))
    assert "The log holds no usable message of: attitude, satellite receiver." in run(tmp_path / "a.tlog")[1]


def test_truth_of_a_part_of_the_flight_is_said_to_be(log: Path, tmp_path: Path) -> None:
    rows = [f"{60_000_000 + 3_000_000 * k},{47.4 + 30 * k * 4.5e-6},8.55,540" for k in range(4)]
    (tmp_path / "truth.csv").write_text("t_us,lat_deg,lon_deg,h_amsl_m\n" + "\n".join(rows))
    code, text = run(tmp_path)
    assert code == 0
    assert re.search(r"Truth is known at [0-4]% of the epochs", text)


def journal(path: Path, *, tamper: bool = False) -> Path:
    config = Config(seed=7)
    navigator = Navigator(core_settings(config))
    writer = JournalWriter(path.open("wb"), JournalHeader(config.model_dump(mode="json")), path=path)
    for k in range(100):
        now_ns = 10**9 + k * 10**8
        event = Tick(now_ns) if k % 2 else Attitude(now_ns, now_ns, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        writer.event(now_ns, event)
        for command in navigator.on(event, now_ns):
            writer.command(now_ns + (5 if tamper and k == 61 else 0), command)
    writer.close()
    return path


def test_a_journal_is_compared_command_by_command(tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    code, text = run(journal(tmp_path / "a.mcap"), "--json", figures)
    assert code == 0
    assert re.search(r"All \d+ commands are byte for byte those of the flight", text)
    assert json.loads(figures.read_text())["commands"]["identical"] is True


def test_a_map_beside_a_journal_is_said_to_change_nothing(tmp_path: Path, tiny_world: Any) -> None:
    """Who gave another map read that all commands are the flight's, as if it made no difference."""
    code, text = run(journal(tmp_path / "a.mcap"), "--map", tiny_world.pack)
    assert code == 0
    assert "the fixes are the flight's: --rerun localises frames anew" in text


def test_a_journal_that_differs_says_where(tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    code, text = run(journal(tmp_path / "a.mcap", tamper=True), "--json", figures)
    commands = json.loads(figures.read_text())["commands"]
    assert code == 1
    assert not commands["identical"]
    assert f"first at command {commands['first_difference'] + 1}" in text


def test_a_journal_is_told_by_its_beginning_and_replayed_in_real_time(tmp_path: Path) -> None:
    path = journal(tmp_path / "a.mcap").rename(tmp_path / "flight.bin")
    started = time.monotonic()
    assert "commands are byte for byte" in run(path, "--speed", "20")[1]
    assert time.monotonic() - started > 0.45, "9.9 s at twenty times the pace"


def test_a_journal_of_no_flight_is_not_identical(tmp_path: Path) -> None:
    """A daemon that was stopped at once leaves a header alone, and of it 0 commands were as recorded: it passed."""
    writer = JournalWriter.create(tmp_path, JournalHeader({}), max_bytes=10**6)
    writer.close()
    assert writer.path is not None
    code, text = run(writer.path, "--json", tmp_path / "figures.json")
    assert (code, "The journal holds no command: nothing was flown." in text) == (1, True)
    assert json.loads((tmp_path / "figures.json").read_text())["commands"]["identical"] is None


def test_a_journal_of_which_nothing_is_left_is_not_identical(tmp_path: Path) -> None:
    path = journal(tmp_path / "a.mcap")
    data, at = path.read_bytes(), 8
    while data[at] != CHUNK or at < 1000:
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    path.write_bytes(data[: at + 20])
    figures = tmp_path / "figures.json"
    code, text = run(path, "--salvage", "--json", figures)
    assert (code, "no command can be compared with the flight's." in text) == (1, True)
    assert "FAILED: commands identical to the recording (is not known, none can be compared)" in text
    assert json.loads(figures.read_text())["commands"]["identical"] is None


def test_a_journal_whose_header_is_damaged_is_salvaged_with_the_flights_configuration(tmp_path: Path) -> None:
    path = journal(tmp_path / "a.mcap")
    data = bytearray(path.read_bytes())
    data[data.index(b"\x04\0\0\0zstd") + 30] ^= 1
    path.write_bytes(data)
    (tmp_path / "a.toml").write_text("seed = 7\n")
    with pytest.raises(JournalError, match=r"holds no header; remedy: .*--salvage --config FILE"):
        run(path, "--salvage")
    code, text = run(path, "--salvage", "--config", tmp_path / "a.toml")
    assert code == 0
    assert re.search(r"Damaged: byte \d+: a chunk is damaged", text)
    assert re.search(r"commands are byte for byte those of the flight\. The configuration is not the flight's own", text)


def test_a_cut_journal_needs_salvage(tmp_path: Path) -> None:
    path = journal(tmp_path / "a.mcap")
    path.write_bytes(path.read_bytes()[:-400])
    with pytest.raises(JournalError, match="is damaged"):
        run(path)
    code, text = run(path, "--salvage")
    assert code == 0
    assert "Damaged: " in text


def test_a_truth_with_exchanged_columns_is_refused(log: Path, tmp_path: Path) -> None:
    (tmp_path / "truth.csv").write_text("t_us,lat_deg,lon_deg,h_amsl_m\n60000000,8.55,47.4,540\n69000000,8.55,47.4,540\n")
    with pytest.raises(LogError, match=r"truth\.csv: latitude and longitude are exchanged"):
        run(log.parent)


def test_a_truth_of_elsewhere_is_refused_beside_a_map(log: Path, tmp_path: Path, tiny_world: Any) -> None:
    (tmp_path / "truth.csv").write_text("t_us,lat_deg,lon_deg,h_amsl_m\n60000000,-47.4,8.55,540\n69000000,-47.4,8.55,540\n")
    with pytest.raises(LogError, match=r"truth\.csv: none of its places lies near the map"):
        run(log.parent, "--map", tiny_world.pack)
    code, text = run(log.parent)
    assert code == 0
    assert re.search(r"All places of the truth lie \d+ km and more from the log's positions: are they of one flight\?", text)


def test_a_truth_that_lies_elsewhere_than_gnss_that_is_ok_is_told_of(log: Path, tmp_path: Path) -> None:
    rows = [f"{60_000_000 + 100_000 * k},{47.5 + k * 4.5e-6},8.55,540" for k in range(100)]
    (tmp_path / "truth.csv").write_text("t_us,lat_deg,lon_deg,h_amsl_m\n" + "\n".join(rows))
    code, text = run(log.parent)
    assert code == 0
    assert re.search(r"WARNING: while GNSS counted as OK, the receiver lay 111\d\d m from the truth \(median\)", text)


def test_what_the_operator_would_have_been_told_is_among_the_notes(log: Path) -> None:
    mav = mavlink2.MAVLink(None, srcSystem=1, srcComponent=1)
    pieces = []
    for k in range(100, 160):
        boot, lat = 60_000 + 100 * k, round((47.4 + k * 4.5e-6) * 1e7)
        for message in (
            mav.heartbeat_encode(2, 3, 0x81, 0, 4),
            mav.attitude_encode(boot, 0, 0, 0, 0, 0, 0),
            mav.gps_raw_int_encode(boot * 1000, 1, 0, 0, 0, 9999, 9999, 0, 0, 0),
            mav.global_position_int_encode(boot, lat, 85_500_000, 540_000, 50_000, 500, 0, 0, 0),
        ):
            pieces.append(struct.pack(">Q", UNIX_US + 100_000 * k) + bytes(message.pack(mav)))
    log.write_bytes(log.read_bytes() + b"".join(pieces))
    assert re.search(r"The operator would have been told after 1[12]\.\d s: visloc: GNSS lost, no fix", run(log)[1])
