"""`visloc doctor` as a command: exit codes, the table, the file of changes, JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from visloc_companion.cli import doctor as command
from visloc_companion.cli.main import app, main
from visloc_companion.config import Config
from visloc_companion.doctor.examine import Report, Wishes
from visloc_companion.doctor.facts import Facts
from visloc_companion.doctor.finding import judge
from visloc_companion.doctor.parameter_file import changes
from visloc_companion.doctor.rules.registry import RULES
from visloc_companion.errors import ConfigError, LinkError
from visloc_companion.types import AutopilotKind


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Wishes]:
    """What was asked of an examination, which finds an ArduPilot with VISO_QUAL_MIN as its URL ends in."""
    wishes: list[Wishes] = []

    async def examine(wish: Wishes) -> Report:
        wishes.append(wish)
        parameters = {"VISO_QUAL_MIN": float(wish.url.rpartition(":")[2]), "EK3_SRC1_POSXY": 3.0}
        facts = Facts(AutopilotKind.ARDUPILOT, "4.7.0", parameters, wish.config)
        return Report(facts, judge(RULES, facts), changes(RULES, facts))

    monkeypatch.setattr("visloc_companion.doctor.examine.examine", examine)
    return wishes


def run(*words: str) -> Any:
    return CliRunner().invoke(app, ["doctor", *words], env={"COLUMNS": "200"})


def test_red_is_exit_code_1_with_the_remedy_in_all_forms(asked: list[Wishes], tmp_path: Path) -> None:
    found, fix = tmp_path / "found.json", tmp_path / "fix.param"
    done = run("--link", "tcp:h:50", "--json", str(found), "--fix", str(fix))
    assert done.exit_code == 1
    assert "VISO_QUAL_MIN  50 -> 0" in done.output
    assert "ardupilot 4.7.0: 1 red, 0 amber" in done.output
    assert fix.read_text(encoding="utf-8").splitlines()[-1] == "VISO_QUAL_MIN,0"
    rules = json.loads(found.read_text(encoding="utf-8"))["rules"]
    assert rules[0]["id"] == "ap-viso-quality"
    assert rules[0]["remedy"] == "set VISO_QUAL_MIN = 0"
    assert asked[0].apply is False


def test_a_file_that_cannot_be_written_is_named(asked: list[Wishes], tmp_path: Path) -> None:
    for option in ("--json", "--fix"):
        done = run("--link", "tcp:h:0", "--apply", option, str(tmp_path / "missing" / "found"))
        assert isinstance(done.exception, ConfigError)
        assert "found: its folder does not exist; remedy: name a file in an existing folder for " + option in str(done.exception)
    assert asked == []  # before anything is set


@pytest.mark.parametrize("option", ["--json", "--fix"])
def test_a_full_disk_is_named(asked: list[Wishes], option: str) -> None:
    done = run("--link", "tcp:h:0", option, "/dev/full")
    assert isinstance(done.exception, ConfigError)
    assert "/dev/full: cannot be written" in str(done.exception)


def test_nothing_red_is_exit_code_0_and_skipped_rules_are_shown_on_demand(asked: list[Wishes]) -> None:
    short, long = run("--link", "tcp:h:0"), run("--link", "tcp:h:0", "--all", "--apply")
    assert short.exit_code == long.exit_code == 0
    assert "link-origin" not in short.output
    assert "link-origin" in long.output
    assert "px4-ev-control" not in long.output
    assert asked[1].apply is True


def test_what_must_change_is_not_told_of_an_autopilot_that_was_not_read(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """An empty file in place of yesterday's reads as one with which nothing must change."""

    async def examine(wish: Wishes) -> Report:
        facts = Facts(AutopilotKind.UNKNOWN, "", {}, wish.config)
        return Report(facts, judge(RULES, facts), {}, problem=LinkError("nothing is heard", where=wish.url))

    monkeypatch.setattr("visloc_companion.doctor.examine.examine", examine)
    fix = tmp_path / "fix.param"
    fix.write_text("VISO_QUAL_MIN,0\n", encoding="utf-8")
    for before in ("VISO_QUAL_MIN,0\n", None):
        done = run("--link", "tcp:h:0", "--fix", str(fix), "--json", str(tmp_path / "found.json"))
        assert isinstance(done.exception, LinkError)
        assert f"{fix} is not written: no parameter of the autopilot was read" in done.output
        assert (fix.read_text(encoding="utf-8") if fix.exists() else None) == before
        fix.unlink(missing_ok=True)
    assert (tmp_path / "found.json").is_file()


def test_the_link_of_the_configuration_is_taken_and_given_way_to(asked: list[Wishes], tmp_path: Path) -> None:
    path = tmp_path / "visloc.toml"
    path.write_text('[link]\nurl = "tcp:h:0"\nsystem_id = 4\n[localiser]\nterrain = true\n', encoding="utf-8")
    assert run("--config", str(path)).exit_code == 0
    run("--config", str(path), "--link", "tcp:other:0")
    configs = [wish.config or Config() for wish in asked]
    assert [wish.url for wish in asked] == ["tcp:h:0", "tcp:other:0"]
    assert [(config.link.url, config.link.system_id) for config in configs] == [("tcp:h:0", 4), ("tcp:other:0", 4)]


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        ([], 2, "--link URL"),
        (["--config", "/none.toml"], 2, "cannot be read"),
        (["--link", "pigeon:home:1"], 2, "pigeon"),
        (["--link", "serial:/dev/no-such-port:921600"], 4, "cannot be opened"),
    ],
)
def test_what_cannot_be_asked_has_its_exit_code(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str], code: int, text: str
) -> None:
    monkeypatch.setattr("sys.argv", ["visloc", "doctor", *words])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == code
    assert text in capsys.readouterr().err


def test_the_command_says_what_its_exit_codes_mean() -> None:
    assert "1 a rule is red" in (command.doctor.__doc__ or "")


def test_on_a_narrow_terminal_the_answers_are_listed(asked: list[Wishes]) -> None:
    """The columns of a table of 40 broke every word."""
    done = CliRunner().invoke(app, ["doctor", "--link", "tcp:h:50"], env={"COLUMNS": "40"})
    lines = done.output.splitlines()
    assert lines[0].startswith("red ap-viso-quality: VISO_QUAL_MIN = 50")
    assert "- set VISO_QUAL_MIN = 0" in lines
    assert max(map(len, lines)) <= 40


def test_the_files_are_written_though_nobody_reads_the_table(
    asked: list[Wishes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone(*_: object) -> None:
        raise BrokenPipeError

    monkeypatch.setattr(command, "_print", gone)
    found, fix = tmp_path / "found.json", tmp_path / "fix.param"
    assert run("--link", "tcp:h:50", "--json", str(found), "--fix", str(fix)).exit_code != 0
    assert json.loads(found.read_text(encoding="utf-8"))["rules"]
    assert fix.read_text(encoding="utf-8").splitlines()[-1] == "VISO_QUAL_MIN,0"
