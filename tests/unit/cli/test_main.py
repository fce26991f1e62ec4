"""The command itself: quick to start, and clear about what went wrong."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from visloc_companion import __version__, errors
from visloc_companion.cli import main as module
from visloc_companion.cli import start
from visloc_companion.config import load_config
from visloc_companion.errors import CameraError, ConfigError, JournalError, LinkError, MapError, VislocError, WorkerError

HEAVY = {"cv2", "numpy", "rasterio", "pymavlink", "pydantic", "pyproj", "filterpy", "mcap", "structlog", "serial"}
PRINT_MODULES = "import sys, visloc_companion.cli.main; print(*sorted(m.partition('.')[0] for m in sys.modules))"


def test_nothing_heavy_is_imported_before_a_command_runs() -> None:
    """`visloc --help` answers at once because the libraries are imported by the commands that need them."""
    done = subprocess.run([sys.executable, "-c", PRINT_MODULES], capture_output=True, text=True, check=True)
    assert HEAVY & set(done.stdout.split()) == set()
    assert "typer" in done.stdout.split()


def test_every_command_is_named_in_the_help() -> None:
    result = CliRunner().invoke(module.app, ["--help"])
    assert result.exit_code == 0
    for command in ("run", "replay", "sim", "demo", "web", "map", "evaluate", "calibrate"):
        assert f" {command} " in result.output
    assert CliRunner().invoke(module.app, []).output.strip() == result.output.strip()


@pytest.mark.parametrize("command", ["run", "replay", "sim", "demo", "web", "map", "evaluate", "calibrate"])
def test_every_command_has_help(command: str) -> None:
    result = CliRunner().invoke(module.app, [command, "-h"])
    assert result.exit_code == 0
    assert "Usage" in result.output


def test_the_version_is_the_packages() -> None:
    result = CliRunner().invoke(module.app, ["--version"])
    assert (result.exit_code, result.output) == (0, f"visloc-companion {__version__}\n")


@pytest.mark.parametrize("arguments", [["fly"], ["sim", "--sead", "1"], ["sim", "--seed", "one"], ["sim", "--jobs", "0"]])
def test_wrong_usage_is_2(arguments: list[str]) -> None:
    assert CliRunner().invoke(module.app, arguments).exit_code == 2


def test_the_exit_code_tells_the_kind_of_error() -> None:
    codes = {ConfigError: 2, LinkError: 4, MapError: 3, CameraError: 3, JournalError: 3, WorkerError: 3}
    for kind, code in codes.items():
        assert module.exit_code(kind("what")) == code
    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, VislocError)]
    assert {module.exit_code(kind("what")) for kind in kinds} == {2, 3, 4}


@pytest.mark.parametrize(("fault", "code"), [(errno.EIO, 3), (errno.EROFS, 3), (errno.ENOENT, 2), (errno.EACCES, 2)])
def test_a_card_that_could_not_be_read_is_no_wrong_configuration(monkeypatch: pytest.MonkeyPatch, fault: int, code: int) -> None:
    """After exit code 2 systemd starts no daemon again, however far away the vehicle is."""

    def fails(*_: object, **__: object) -> str:
        raise OSError(fault, os.strerror(fault))

    monkeypatch.setattr(Path, "read_text", fails)
    with pytest.raises(ConfigError, match="cannot be read") as refused:
        load_config(Path("visloc.toml"))
    assert module.exit_code(refused.value) == code


@pytest.mark.parametrize(
    ("error", "line", "code"),
    [
        (ConfigError("is wrong", where="a.toml", remedy="mend it"), "error: a.toml: is wrong; remedy: mend it\n", 2),
        (CameraError("is gone", where="/dev/video0"), "camera error: /dev/video0: is gone\n", 3),
        (LinkError("is silent"), "error: is silent\n", 4),
    ],
)
def test_an_error_becomes_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], error: VislocError, line: str, code: int
) -> None:
    def fail() -> None:
        raise error

    monkeypatch.setattr(module, "app", fail)
    with pytest.raises(SystemExit) as end:
        module.main()
    assert end.value.code == code
    assert capsys.readouterr().err == line


def test_other_exceptions_are_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(module, "app", fail)
    with pytest.raises(ZeroDivisionError):
        module.main()


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["evaluate", "image", "cases", "--report", ""], "what follows --report"),
        (["replay", "flight.tlog", "--gate="], "--gate"),
        (["map", "info", ""], "what follows info"),
        ([""], "what follows visloc"),
    ],
)
def test_what_is_empty_is_not_taken_for_this_folder(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str], named: str
) -> None:
    """`--report "$UNSET"` wrote a page where the shell happened to be, and `--gate "$UNSET"` failed nothing."""
    monkeypatch.setattr(sys, "argv", ["visloc", *arguments])
    monkeypatch.setattr(module, "app", lambda: pytest.fail("a command began"))
    with pytest.raises(SystemExit) as end:
        module.main()
    assert end.value.code == 2
    assert capsys.readouterr().err.startswith(f"error: {named}: is empty; remedy: give it a value")


def test_ctrl_c_while_it_is_loaded_leaves_no_traceback(tmp_path: Path) -> None:
    (tmp_path / "typer.py").write_text("raise KeyboardInterrupt")
    code = "from visloc_companion.cli.start import main; main()"
    environment = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
    done = subprocess.run([sys.executable, "-c", code], check=False, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_nor_does_it_while_the_commands_are_put_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """Typer looks at every option of every command for a tenth of a second before it listens for Ctrl-C itself."""

    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "app", interrupted)
    monkeypatch.setattr(sys, "argv", ["visloc", "sim"])
    with pytest.raises(SystemExit) as end:
        start.main()
    assert end.value.code == 130
