"""The systemd unit fits the daemon."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
import typer.main

from visloc_companion.app import live
from visloc_companion.app.worker import _START_S
from visloc_companion.cli.main import app, exit_code
from visloc_companion.config import load_config
from visloc_companion.errors import CameraError, ConfigError, JournalError, LinkError, WorkerError

ROOT = Path(__file__).resolve().parents[3]
UNITS, EXAMPLES = ROOT / "systemd", ROOT / "docs" / "examples"


def directives_of(unit: str) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for line in (UNITS / unit).read_text().splitlines():
        if line and not line.startswith(("#", "[")):
            name, _, value = line.partition("=")
            found.setdefault(name, []).append(value)
    return found


@pytest.fixture(scope="module")
def directives() -> dict[str, list[str]]:
    return directives_of("visloc.service")


@pytest.fixture(scope="module")
def of_the_page() -> dict[str, list[str]]:
    return directives_of("visloc-web.service")


def told(command: str) -> list[list[str]]:
    """The commands of docs/on-a-drone.md, As a service, that have this word."""
    section = (ROOT / "docs" / "on-a-drone.md").read_text(encoding="utf-8").partition("## As a service")[2]
    block = re.findall(r"^```sh\n(.*?)^```", section, re.MULTILINE | re.DOTALL)[0]
    return [words for words in map(shlex.split, block.splitlines()) if command in words]


def test_what_is_installed_as_told_is_what_was_tested_where_the_unit_looks_for_it(directives: dict[str, list[str]]) -> None:
    program, *arguments = shlex.split(directives["ExecStart"][0])
    (pip,) = [words for words in told("install") if words[1].endswith("/pip")]
    assert Path(pip[1]).parent == Path(program).parent
    assert Path(pip[pip.index("-c") + 1]).name == "constraints.txt"
    assert any(words[-1] == arguments[-1] for words in told("install")), "the configuration"
    assert [words[words.index("useradd") :][-1] for words in told("useradd")] == directives["User"]


def test_it_starts_the_daemon_and_waits_for_its_word(directives: dict[str, list[str]]) -> None:
    (command,) = directives["ExecStart"]
    program, *arguments = shlex.split(command)
    assert program.endswith("/bin/visloc")
    assert arguments[:2] == ["run", "--config"]
    assert directives["Type"] == ["notify"]
    assert float(directives["TimeoutStartSec"][0]) > _START_S


def test_in_flight_it_is_started_again_at_once_however_often_it_fails(directives: dict[str, list[str]]) -> None:
    """PX4's failsafe comes 4.5 s after the last position, and a start takes most of that."""
    assert float(directives["RestartSec"][0]) <= 0.1
    assert directives["StartLimitIntervalSec"] == ["0"]


def test_the_watchdog_waits_for_several_beats(directives: dict[str, list[str]]) -> None:
    assert float(directives["WatchdogSec"][0]) >= 4 * live._WATCH_S


def test_only_the_daemon_gets_the_first_signal(directives: dict[str, list[str]]) -> None:
    assert directives["KillMode"] == ["mixed"]


def test_only_errors_of_the_configuration_are_final(directives: dict[str, list[str]]) -> None:
    assert directives["Restart"] == ["on-failure"]
    final = {int(code) for code in directives["RestartPreventExitStatus"][0].split()}
    assert exit_code(ConfigError("")) in final
    for passing in (CameraError(""), WorkerError(""), JournalError(""), LinkError("")):
        assert exit_code(passing) not in final
    assert directives["StartLimitIntervalSec"] == ["0"]


@pytest.mark.parametrize("example", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.stem)
def test_what_the_examples_write_to_is_writable_and_there_after_a_stop(directives: dict[str, list[str]], example: Path) -> None:
    config = load_config(example)
    if config.journal.folder:
        assert Path(config.journal.folder).is_relative_to(Path("/var/lib", directives["StateDirectory"][0]))
    if config.status.socket:
        assert Path(config.status.socket).parent == Path("/run", directives["RuntimeDirectory"][0])
        assert directives["RuntimeDirectoryPreserve"] == ["yes"]


def test_it_is_fenced_in(directives: dict[str, list[str]]) -> None:
    for name, value in {
        "ProtectSystem": "strict",
        "NoNewPrivileges": "yes",
        "DevicePolicy": "closed",
        "PrivateTmp": "yes",
    }.items():
        assert directives[name] == [value]
    assert "AF_UNIX" in directives["RestrictAddressFamilies"][0]  # NOTIFY_SOCKET and the status socket


def test_the_dashboard_is_started_by_options_that_there_are(of_the_page: dict[str, list[str]]) -> None:
    (command,) = of_the_page["ExecStart"]
    program, *arguments = shlex.split(command)
    assert program.endswith("/bin/visloc")
    assert arguments[:2] == ["web", "--config"]
    options = {name for param in typer.main.get_command(app).commands["web"].params for name in param.opts}  # type: ignore[attr-defined]
    assert {word for word in arguments if word.startswith("--")} <= options
    assert "--host" not in arguments, "on this computer only, unless somebody decides otherwise"


def test_the_dashboard_may_ask_the_daemon_and_is_not_the_daemons_user(
    directives: dict[str, list[str]], of_the_page: dict[str, list[str]]
) -> None:
    assert of_the_page["DynamicUser"] == ["yes"]
    assert "User" not in of_the_page
    assert of_the_page["SupplementaryGroups"] == directives["Group"]
    assert "AF_UNIX" in of_the_page["RestrictAddressFamilies"][0]


def test_the_dashboard_gives_way_to_the_daemon(directives: dict[str, list[str]], of_the_page: dict[str, list[str]]) -> None:
    assert int(of_the_page["CPUWeight"][0]) * 10 <= int(directives["CPUWeight"][0])
    assert int(of_the_page["OOMScoreAdjust"][0]) > 0
    assert not {"Requires", "BindsTo", "PartOf"} & of_the_page.keys(), "it goes on and says so when the daemon is down"
    assert not {"Wants", "Requires", "BindsTo"} & directives.keys(), "and the daemon needs no dashboard"


def test_the_dashboard_is_fenced_in_further(of_the_page: dict[str, list[str]]) -> None:
    for name in ("NoNewPrivileges", "PrivateDevices", "PrivateTmp", "ProtectHome", "ProtectKernelModules", "RestrictNamespaces"):
        assert of_the_page[name] == ["yes"], name
    assert of_the_page["ProtectSystem"] == ["strict"]
    assert of_the_page["CapabilityBoundingSet"] == [""]
    assert not {"ReadWritePaths", "StateDirectory", "DeviceAllow"} & of_the_page.keys()
