"""What lies where the daemon's user may not look, and names that no file can have, are problems like others."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

import pytest

from visloc_companion.app.preflight import preflight
from visloc_companion.cli import main as module
from visloc_companion.config import parse_config
from visloc_companion.errors import MapError
from visloc_companion.maps.manifest import MANIFEST, read_manifest

NO_NAME = "/var/lib/" + 300 * "x"
"""Longer than file systems allow: to ask whether it is there is an error, as it is below a folder that may not be entered."""
LENS = {"width_px": 640, "height_px": 480, "fx_px": 554.0, "fy_px": 554.0, "cx_px": 319.5, "cy_px": 239.5}


@pytest.mark.parametrize(
    "told",
    [
        {"map": {"pack": NO_NAME}},
        {"journal": {"folder": NO_NAME}},
        {"camera": {"url": f"files:{NO_NAME}", **LENS}},
        {"camera": {"url": f"video:{NO_NAME}.mp4", **LENS}},
    ],
    ids="-".join,
)
def test_a_check_names_what_it_cannot_reach(told: dict[str, Any]) -> None:
    problems, _ = preflight(parse_config(told))
    (unreached,) = [problem for problem in problems if NO_NAME in problem.where]
    assert unreached.remedy


def denied(*_: object, **__: object) -> None:
    raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), "/home/pilot/flight")


def test_a_pack_that_may_not_be_read_is_not_to_be_built_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "stat", denied)
    with pytest.raises(MapError, match=f"{MANIFEST}: cannot be read: Permission denied; remedy: .*chmod -R a\\+rX"):
        read_manifest(Path("field"))


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["replay", NO_NAME], 3),
        (["map", "info", NO_NAME], 3),
        (["map", "build", "--ortho", f"{NO_NAME}.tif", "--out", "pack"], 3),
        (["sim", "--scenario", "jam", "--json", NO_NAME], 2),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else None,
)
def test_a_command_says_in_one_line_what_it_cannot_reach(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str], code: int
) -> None:
    monkeypatch.setattr("sys.argv", ["visloc", *words])
    with pytest.raises(SystemExit) as end:
        module.main()
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {NO_NAME}")
    assert "remedy: " in line
    assert end.value.code == code


def test_a_command_that_may_not_read_a_file_names_it(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(module, "app", denied)
    with pytest.raises(SystemExit) as end:
        module.main()
    assert end.value.code == 3
    assert capsys.readouterr().err.startswith("error: /home/pilot/flight: cannot be used: Permission denied; remedy: ")


@pytest.mark.parametrize("fault", [OSError(errno.EACCES, "no file is named"), OSError(errno.EMFILE, "too many", "a.mcap")])
def test_other_faults_of_the_system_are_not_hidden(monkeypatch: pytest.MonkeyPatch, fault: OSError) -> None:
    def fail() -> None:
        raise fault

    monkeypatch.setattr(module, "app", fail)
    with pytest.raises(OSError, match=str(fault.strerror)):
        module.main()
