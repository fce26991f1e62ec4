"""`visloc link-key` makes a key file that the daemon takes."""

import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

from visloc_companion.adapters.mavlink.signing_key import read_key
from visloc_companion.cli.main import app
from visloc_companion.errors import ConfigError


def test_a_key_is_made_once_and_not_shown(tmp_path: Path) -> None:
    path = tmp_path / "signing.key"
    first = CliRunner().invoke(app, ["link-key", "--out", str(path)])
    assert first.exit_code == 0
    assert len(read_key(path)) == 32
    assert path.read_text().strip() not in first.output
    second = CliRunner().invoke(app, ["link-key", "--out", str(path)])
    assert isinstance(second.exception, ConfigError)


def test_a_full_disk_leaves_no_file_in_the_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "signing.key"
    opened = os.open

    def on_a_full_disk(name: Path, *how: int) -> int:
        os.close(opened(name, *how))
        return opened("/dev/full", os.O_WRONLY)

    with monkeypatch.context() as patch:
        patch.setattr(os, "open", on_a_full_disk)
        failed = CliRunner().invoke(app, ["link-key", "--out", str(path)])
    assert isinstance(failed.exception, ConfigError)
    assert "signing.key: cannot be written: No space left on device; remedy: make room" in str(failed.exception)
    assert not path.exists()
    assert CliRunner().invoke(app, ["link-key", "--out", str(path)]).exit_code == 0
