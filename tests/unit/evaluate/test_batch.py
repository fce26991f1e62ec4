"""Every item has its result, in order, whoever did it."""

from __future__ import annotations

import os
from functools import partial

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


def test_no_items_have_no_results() -> None:
    assert list(run_all([], HERE, THERE, 2)) == []
