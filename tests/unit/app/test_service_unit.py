"""The systemd unit fits the daemon."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from visloc_companion.app import live
from visloc_companion.app.worker import _START_S
from visloc_companion.cli.main import exit_code
from visloc_companion.config import load_config
from visloc_companion.errors import CameraError, ConfigError, JournalError, LinkError, WorkerError

ROOT = Path(__file__).resolve().parents[3]
UNIT, EXAMPLES = ROOT / "systemd" / "visloc.service", ROOT / "docs" / "examples"


@pytest.fixture(scope="module")
def directives() -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for line in UNIT.read_text().splitlines():
        if line and not line.startswith(("#", "[")):
            name, _, value = line.partition("=")
            found.setdefault(name, []).append(value)
    return found


def test_it_starts_the_daemon_and_waits_for_its_word(directives: dict[str, list[str]]) -> None:
    (command,) = directives["ExecStart"]
    program, *arguments = shlex.split(command)
    assert program.endswith("/bin/visloc")
    assert arguments[:2] == ["run", "--config"]
    assert directives["Type"] == ["notify"]
    assert float(directives["TimeoutStartSec"][0]) > _START_S


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
