"""Every item has its result, in order, whoever did it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import cv2
import pytest

from visloc_companion.evaluate.batch import run_all


def result_of(item: int, who: str) -> tuple[int, str]:
    return item, who


def process_of(item: int) -> tuple[int, int]:
    return os.getpid(), cv2.getNumThreads()


HERE, THERE = (partial(result_of, who=who) for who in ("here", "there"))


@pytest.mark.parametrize("jobs", [0, 1])
def test_one_process_is_this_one(jobs: int) -> None:
    assert list(run_all([3, 1, 2], HERE, THERE, jobs)) == [(3, "here"), (1, "here"), (2, "here")]
    assert list(run_all([0], process_of, process_of, jobs)) == [(os.getpid(), 1)]


def test_other_processes_keep_the_order_and_one_thread() -> None:
    assert list(run_all([3, 1, 2], HERE, THERE, 2, at_once=2)) == [(3, "there"), (1, "there"), (2, "there")]
    assert all(pid != os.getpid() and threads == 1 for pid, threads in run_all([0, 1], process_of, process_of, 2))


def test_what_a_killed_process_leaves_is_done_here(dying_pool: None) -> None:
    assert list(run_all([3, 1, 2], HERE, THERE, 2)) == [(3, "there"), (1, "here"), (2, "here")]


def slow(item: int, folder: Path) -> int:
    (folder / str(item)).touch()
    time.sleep(0.1)
    return item


def break_off(folder: Path) -> None:
    """Ctrl-C after the first result: a terminal sends it to every process of the group."""
    work = partial(slow, folder=folder)
    for _ in run_all(range(120), work, work, 2, at_once=20):
        os.killpg(0, signal.SIGINT)


def test_ctrl_c_ends_the_other_processes_with_the_item_that_they_are_at(tmp_path: Path) -> None:
    """Four chunks are done or begun then; the last two are left as soon as the others hear of it."""
    script, items = tmp_path / "script.py", tmp_path / "items"
    items.mkdir()
    script.write_text(
        f"import pathlib, sys\nsys.path.insert(0, {str(Path(__file__).parent)!r})\nimport test_batch\n"
        f"if __name__ == '__main__':\n    test_batch.break_off(pathlib.Path({str(items)!r}))\n",
        encoding="utf-8",
    )
    ended = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, start_new_session=True, timeout=100, check=False
    )
    assert ended.returncode != 0
    assert ended.stderr.count("Traceback") == 1, ended.stderr
    assert "KeyboardInterrupt" in ended.stderr
    assert 20 <= len(list(items.iterdir())) <= 65


def test_no_items_have_no_results() -> None:
    assert list(run_all([], HERE, THERE, 2)) == []
