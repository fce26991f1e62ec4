"""Progress goes to stderr in plain lines where it is no terminal; results are JSON without infinities."""

from __future__ import annotations

import csv
import json
import math
import os
import re
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from typer.testing import CliRunner

from visloc_companion.cli import progress
from visloc_companion.cli.main import app
from visloc_companion.cli.progress import bar, require_folder, results_into, spinner, write_json
from visloc_companion.errors import ConfigError
from visloc_companion.evaluate.cases import COLUMNS


def test_a_bar_tells_every_tenth_once(capsys: pytest.CaptureFixture[str]) -> None:
    with bar("flying", 200.0) as advance:
        for done in range(201):
            advance(float(done))
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.splitlines() == [f"flying: {share}%" for share in range(10, 101, 10)]


def test_a_bar_of_nothing_is_done(capsys: pytest.CaptureFixture[str]) -> None:
    with bar("flying", 0.0) as advance:
        advance(0.0)
    assert capsys.readouterr().err == "flying: 100%\n"


def test_a_spinner_tells_its_stages(capsys: pytest.CaptureFixture[str]) -> None:
    with spinner("world") as tell:
        tell("making [the] landscape")
        tell("building")
    told = capsys.readouterr()
    assert (told.out, told.err) == ("", "world: making [the] landscape\nworld: building\n")


def test_a_terminal_is_left_clean(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """On a terminal the bar and the spinner vanish when they are done, and an error inside passes through."""
    monkeypatch.setattr(progress, "Console", lambda **_: Console(stderr=True, force_terminal=True, width=80))
    with bar("flying", 10.0) as advance:
        advance(5.0)
    with pytest.raises(ZeroDivisionError), spinner("world") as tell:
        tell("making")
        raise ZeroDivisionError
    assert capsys.readouterr().out == ""


def test_json_is_utf8_and_finite(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    write_json(path, {"limit": "≤ 2 m", "median_m": 0.5, "modes": [(0.0, "waiting")], "failsafe": None})
    text = path.read_text(encoding="utf-8")
    assert "≤ 2 m" in text
    assert text.endswith("}\n")
    assert json.loads(text)["modes"] == [[0.0, "waiting"]]
    for number in (math.nan, math.inf):
        with pytest.raises(ValueError, match="not JSON compliant"):
            write_json(tmp_path / "never.json", {"value": number})
    assert not (tmp_path / "never.json").exists()


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"cannot be written.*--json"):
        write_json(tmp_path, {})


def test_a_full_disk_leaves_the_result_of_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "result.json"
    (tmp_path / "link.json").symlink_to(path)
    write_json(tmp_path / "link.json", {"n": 1})
    opened = Path.open

    def full(self: Path, mode: str = "r", **options: Any) -> Any:
        if "w" not in mode:
            return opened(self, mode, **options)
        opened(self, mode, **options).close()
        return opened(Path("/dev/full"), mode, **options)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "open", full)
        with pytest.raises(ConfigError, match=r"result\.json: cannot be written: .*No space left.*--json"):
            write_json(path, {"n": 2})
    assert json.loads(path.read_text(encoding="utf-8")) == {"n": 1}
    assert sorted(tmp_path.iterdir()) == [tmp_path / "link.json", path]
    assert (tmp_path / "link.json").is_symlink()


def test_a_json_may_go_to_a_pipe(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_json(pipe, {"n": 1})
    assert json.loads(os.read(reader, 100)) == {"n": 1}
    os.close(reader)


def test_what_may_not_be_written_is_found_before_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(ConfigError, match=r"result\.json: may not be written; remedy: name a writable file for --json"):
        require_folder(tmp_path / "result.json", "--json")
    with (
        pytest.raises(ConfigError, match=r"cannot be written: .*Permission denied.*folder for --out"),
        results_into(tmp_path, "--out"),
    ):
        raise AssertionError("the work began")


def test_a_folder_that_is_missing_is_found_before_the_work(tmp_path: Path) -> None:
    require_folder(None, "--json")
    require_folder(tmp_path / "result.json", "--json")
    with pytest.raises(ConfigError, match=r"its folder does not exist.*--report"):
        require_folder(tmp_path / "none" / "report.html", "--report")


@pytest.mark.parametrize(
    "arguments",
    [
        "replay FILE --json FILE",
        "replay other.tlog --config FILE --json FILE",
        "replay other.tlog --out . --json report.html",
        "map check . --route FILE --json FILE",
        "map check . --json manifest.json",
        "map info . --json ./manifest.json",
        "map features . --json manifest.json",
        "map build --ortho a.tif FILE --out PACK --json FILE",
        "map build --ortho a.tif --dsm FILE --out PACK --json FILE",
        "sim --campaign FILE --json FILE",
        "sim --scenario jam --json FILE --report link",
        "sim --scenario jam --report FILE --journal FILE",
        "sim --scenario jam --map . --json manifest.json",
        "evaluate image . --json cases.csv",
        "evaluate cloud . --json truth.json",
        "run --check --config FILE --json FILE",
        "doctor --config config.toml --json config.toml",
        "doctor --link udpin:127.0.0.1:14999 --fix FILE --json link",
        "doctor --link udpin:127.0.0.1:14999 --config config.toml --fix config.toml",
    ],
)
def test_no_result_replaces_what_is_read_or_written_besides(
    arguments: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A flight's log and a campaign's list were gone after a slip."""
    monkeypatch.chdir(tmp_path)
    for name in ("FILE", "manifest.json", "cases.csv", "truth.json", "report.html"):
        Path(name).write_text("kept", encoding="utf-8")
    Path("config.toml").touch()
    Path("link").symlink_to("FILE")
    ended = CliRunner().invoke(app, arguments.split())
    assert isinstance(ended.exception, ConfigError)
    assert "is named twice, and would be overwritten; remedy: name another file for --" in str(ended.exception)
    assert Path("FILE").read_text(encoding="utf-8") == "kept"


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ("evaluate image CASES --method gradient --json f.png", "f.png"),
        ("evaluate image CASES --method gradient --json CASES/notes.txt", "notes.txt"),
        ("evaluate image CASES --method gradient --json a.tif", "a.tif"),
        ("evaluate image CASES --method gradient --json PACK/ortho.tif", "ortho.tif"),
        ("evaluate cloud CASES --json cloud.npz", "cloud.npz"),
        ("replay FLIGHT --json FLIGHT/frames/f.png", "f.png"),
        ("replay FLIGHT --map PACK --json PACK/ortho.tif", "ortho.tif"),
        ("sim --scenario jam --map PACK --json PACK/ortho.tif", "ortho.tif"),
        ("sim --scenario jam --map PACK --report PACK/ortho.tif", "ortho.tif"),
        ("map info PACK --json PACK/ortho.tif", "ortho.tif"),
        ("map check PACK --json PACK/ortho.tif", "ortho.tif"),
        ("map check PACK --trusted-key fleet.pub --json fleet.pub", "fleet.pub"),
        ("map features PACK --json PACK/ortho.tif", "ortho.tif"),
    ],
)
def test_no_result_replaces_a_file_that_what_is_read_names(
    arguments: str, named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A frame, an orthophoto and a pack's picture were gone after a slip, with exit code 0."""
    monkeypatch.chdir(tmp_path)
    kept = ["f.png", "a.tif", "cloud.npz", "fleet.pub", "CASES/notes.txt", "FLIGHT/frames/f.png", "PACK/ortho.tif"]
    for name in kept:
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).write_text("kept", encoding="utf-8")
    row = dict.fromkeys(COLUMNS, "1") | {"frame": "../f.png", "ortho": "../a.tif", "dsm": ""}
    with Path("CASES/cases.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, COLUMNS)
        writer.writeheader()
        writer.writerows([row, row | {"id": "2", "ortho": str(tmp_path / "PACK")}])
    sigmas = dict.fromkeys(("horizontal_m", "vertical_m", "yaw_deg", "tilt_deg", "scale"), 1)
    cloud = {"id": "1", "source": "../cloud.npz", "reference": "../cloud.npz", **{f"sigma_{k}": v for k, v in sigmas.items()}}
    Path("CASES/cases.json").write_text(json.dumps([cloud]), encoding="utf-8")
    ended = CliRunner().invoke(app, arguments.split())
    assert isinstance(ended.exception, ConfigError), ended.exception
    assert re.search(rf"{named}: is (part of what is read|named twice), and would be overwritten", str(ended.exception))
    assert all(Path(name).read_text(encoding="utf-8") == "kept" for name in kept)


def test_an_input_that_leads_in_a_circle_is_no_fault_of_the_result(tmp_path: Path) -> None:
    """Path.resolve raised RuntimeError, which ended in a traceback."""
    (tmp_path / "loop.tlog").symlink_to("loop.tlog")
    require_folder(tmp_path / "result.json", "--json", tmp_path / "loop.tlog")
    with pytest.raises(ConfigError, match=r"loop\.tlog: cannot be written: .*remedy: name a writable file for --json"):
        require_folder(tmp_path / "loop.tlog", "--json", tmp_path / "loop.tlog")


def test_results_may_share_a_pipe_and_replace_older_ones(tmp_path: Path) -> None:
    older = tmp_path / "result.json"
    older.touch()
    require_folder(older, "--json", tmp_path / "flight.tlog", None)
    require_folder(older, "--json", tmp_path)
    require_folder(tmp_path / "new.txt", "--json", tmp_path)
    require_folder(Path("/dev/null"), "--json", Path("/dev/null"))
