"""What `make` does on a machine whose python3 has no venv: Debian and Ubuntu keep it in a package of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SANS_VENV = """#!/bin/sh
case "$*" in *ensurepip*) test -e {installed}; exit $?;; *) exec {python} "$@";; esac
"""

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="no make on this machine")


def program(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    path.chmod(0o755)
    return path


def made(tmp_path: Path, apt_get: str) -> subprocess.CompletedProcess[str]:
    """`make` of the environment alone, with a python3 that has venv once `tmp_path/installed` is there."""
    python = program(tmp_path / "python3", SANS_VENV.format(installed=tmp_path / "installed", python=sys.executable))
    for name in ("apt-get", "sudo"):
        program(tmp_path / name, apt_get if name == "apt-get" else '#!/bin/sh\nexec "$@"\n')
    asked = ["make", "--silent", f"PYTHON={python}", f"VENV={tmp_path / 'env'}", str(tmp_path / "env/bin/pip")]
    path = f"{tmp_path}{os.pathsep}{os.environ['PATH']}"
    return subprocess.run(asked, cwd=ROOT, env={**os.environ, "PATH": path}, capture_output=True, text=True, check=False)


def test_a_python_without_venv_gets_its_package(tmp_path: Path) -> None:
    ran = made(tmp_path, f'#!/bin/sh\necho "$@" >> {tmp_path}/asked\ncase "$1" in install) touch {tmp_path}/installed;; esac\n')
    assert ran.returncode == 0, ran.stderr
    package = f"python{sys.version_info.major}.{sys.version_info.minor}-venv"
    assert f"installing the package {package}" in ran.stderr
    update, install = (tmp_path / "asked").read_text(encoding="utf-8").splitlines()
    assert update.startswith("update")
    assert install.endswith(package)
    assert (tmp_path / "env/bin/pip").exists()


def test_a_package_that_cannot_be_had_is_told_with_the_remedy(tmp_path: Path) -> None:
    ran = made(tmp_path, '#!/bin/sh\necho "E: no network" >&2\nexit 100\n')
    assert ran.returncode == 2
    assert "E: no network" in ran.stderr
    assert "remedy: apt-get install python3" in ran.stderr
    assert not (tmp_path / "env").exists()
