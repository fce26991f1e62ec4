"""The systemd unit fits the daemon."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from visloc_companion.app import live
from visloc_companion.app.worker import _START_S

UNIT = Path(__file__).resolve().parents[3] / "systemd" / "visloc.service"


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


def test_only_the_daemon_gets_the_first_signal_and_errors_of_configuration_are_final(directives: dict[str, list[str]]) -> None:
    assert directives["KillMode"] == ["mixed"]
    assert directives["Restart"] == ["on-failure"]
    assert directives["RestartPreventExitStatus"] == ["2 3"]


def test_it_is_fenced_in(directives: dict[str, list[str]]) -> None:
    for name, value in {
        "ProtectSystem": "strict",
        "NoNewPrivileges": "yes",
        "DevicePolicy": "closed",
        "PrivateTmp": "yes",
    }.items():
        assert directives[name] == [value]
    assert "AF_UNIX" in directives["RestrictAddressFamilies"][0]  # NOTIFY_SOCKET and the status socket
