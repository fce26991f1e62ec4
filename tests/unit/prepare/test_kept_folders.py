"""Folders of a cache: what is used stays, what nobody uses goes, and so do the drafts of killed processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from visloc_companion.prepare import world as worlds
from visloc_companion.prepare.kept_folders import ABANDONED_S, NOTED_EVERY_S, UNUSED_S, draft_in, hold, remove_unused
from visloc_companion.prepare.world import procedural_world

HOLDING = """
import sys, time
from pathlib import Path
from visloc_companion.prepare.kept_folders import draft_in, hold
if sys.argv[1] == "hold":
    assert hold(Path(sys.argv[2]))
    print("ready", flush=True)
    time.sleep(60)
with draft_in(Path(sys.argv[2]), ".landscape-") as draft:
    (draft / "half").write_text("a world")
    print(draft, flush=True)
    time.sleep(60)
"""


@pytest.fixture
def folder(tmp_path: Path) -> Callable[[str], Path]:
    def make(name: str) -> Path:
        (tmp_path / name / "pack").mkdir(parents=True)
        (tmp_path / name / "pack" / "ortho.tif").write_text("pixels")
        return tmp_path / name

    return make


def age(folder: Path, seconds: float) -> None:
    """Make all of a folder look as old as that."""
    then = time.time() - seconds
    for path in (*folder.rglob("*"), folder):
        os.utime(path, (then, then))


@contextmanager
def another_process(what: str, folder: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    command = [sys.executable, "-c", HOLDING, what, str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield process, process.stdout.readline().strip()
        finally:
            process.kill()


def test_what_nobody_has_used_for_long_is_removed(folder: Callable[[str], Path], tmp_path: Path) -> None:
    old, new, read = folder("old"), folder("new"), folder("read")
    for each, seconds in ((old, UNUSED_S + 60), (new, UNUSED_S - 60), (read, UNUSED_S + 60)):
        age(each, seconds)
    os.utime(read / "pack" / "ortho.tif", (time.time(), time.time() - 2 * UNUSED_S))  # a version that notes no use reads it
    assert remove_unused(tmp_path.iterdir()) == [old]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["new", "read"]


def test_what_another_process_uses_is_never_removed(folder: Callable[[str], Path]) -> None:
    used = folder("used")
    with another_process("hold", used) as (_, said):
        assert said == "ready"
        age(used, 10 * UNUSED_S)
        assert remove_unused([used]) == []
    assert (used / "pack" / "ortho.tif").is_file()
    assert remove_unused([used]) == [used], "its process has ended"


def test_to_hold_is_to_use(folder: Callable[[str], Path], tmp_path: Path) -> None:
    used = folder("used")
    age(used, UNUSED_S + 60)
    assert hold(used)
    assert time.time() - used.stat().st_mtime < NOTED_EVERY_S
    assert not hold(tmp_path / "missing")
    used.rename(tmp_path / "gone")
    assert not hold(used), "a name that another folder had is not held"


def test_the_draft_of_a_killed_process_is_removed_and_that_of_a_working_one_is_not(tmp_path: Path) -> None:
    with another_process("draft", tmp_path) as (process, said):
        left = Path(said)
        age(left, ABANDONED_S + 60)
        with draft_in(tmp_path, ".landscape-"):
            assert (left / "half").is_file(), "its process still works, however slowly"
        process.send_signal(signal.SIGKILL)
        process.wait()
        assert left.is_dir()
        with draft_in(tmp_path, ".landscape-"):
            assert not left.exists()
    assert list(tmp_path.iterdir()) == []


def test_a_draft_that_was_just_left_may_be_that_of_a_version_without_locks(tmp_path: Path) -> None:
    (tmp_path / ".landscape-abc").mkdir()
    with draft_in(tmp_path, ".landscape-"):
        assert (tmp_path / ".landscape-abc").is_dir()


def test_making_a_world_removes_those_of_other_versions_and_says_so(
    folder: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other, recent, foreign = folder("landscape-1-2000m-0123456789ab"), folder("landscape-1-2000m-ba9876543210"), folder("mine")
    age(other, UNUSED_S + 60)
    age(foreign, UNUSED_S + 60)
    monkeypatch.setattr(worlds, "ProcessPoolExecutor", _Full)
    told: list[str] = []
    with pytest.raises(OSError, match="no space left"):
        procedural_world(1, tmp_path, told.append, 400.0, ())
    assert told[0] == "removed what nobody has used for a week: landscape-1-2000m-0123456789ab"
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted((recent.name, foreign.name))


class _Full:
    def __init__(self, *_: object, **__: object) -> None:
        raise OSError("no space left")
