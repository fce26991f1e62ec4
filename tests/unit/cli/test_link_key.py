"""`visloc link-key` makes a key file that the daemon takes."""

from pathlib import Path

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
