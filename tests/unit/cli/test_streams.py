"""Standard streams that are closed, full or no longer read."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

START = "import sys; from visloc_companion.cli.start import main; sys.argv[0] = 'visloc'; main()"
FULL = Path("/dev/full")
WORDS = ["--version"], ["--help"], ["sim", "--list"], ["link-key", "--out", "key"]


def told(arguments: list[str], folder: Path, before: Callable[[], None]) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-c", START, *arguments]
    return subprocess.run(command, cwd=folder, stderr=subprocess.PIPE, check=False, preexec_fn=before)


@pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full")
@pytest.mark.parametrize("arguments", WORDS)
def test_a_full_disk_behind_standard_output_is_named(arguments: list[str], tmp_path: Path) -> None:
    done = told(arguments, tmp_path, lambda: os.dup2(os.open(FULL, os.O_WRONLY), 1))
    line = b"error: standard output: cannot be written: No space left on device; remedy: make room, or send it elsewhere\n"
    assert (done.returncode, done.stderr) == (3, line)


@pytest.mark.parametrize("arguments", WORDS)
@pytest.mark.parametrize("closed", [(1,), (0, 1), (0, 1, 2)])
def test_closed_streams_are_no_fault(arguments: list[str], closed: tuple[int, ...], tmp_path: Path) -> None:
    """`>&-`, and what some starters leave a process; nothing that is opened later gets the number of one."""
    done = told(arguments, tmp_path, lambda: [os.close(number) for number in closed] and None)
    assert (done.returncode, done.stderr) == (0, b"")
    if (tmp_path / "key").exists():
        assert len((tmp_path / "key").read_text().splitlines()) == 1


def test_a_reader_that_goes_away_ends_it_without_words(tmp_path: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    done = told(["link-key", "--out", "key"], tmp_path, lambda: os.dup2(write, 1) and None)
    os.close(write)
    assert (done.returncode, done.stderr) == (1, b"")
