"""A worker whose program fails over one frame after another."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.unit.app.test_worker import Bench, _answers_can_be_imported, bench  # noqa: F401 - the fixture
from visloc_companion.app.worker_process import FAULTS_IN_A_ROW, Faults, is_shortage
from visloc_companion.errors import ModelError, Reason
from visloc_companion.types import Fix, NoFix, WorkerState


async def failed(b: Bench, request_id: int) -> bool:
    """Whether the program failed over it."""
    b.ask(request_id)
    answer = await b.next()
    return isinstance(answer, NoFix) and answer.reason is Reason.BAD_INPUT


@pytest.mark.parametrize("kind", [10, 20, 30])
async def test_one_that_finds_no_memory_is_replaced_and_the_reason_told(kind: int) -> None:
    """It answered every frame by its fault until the flight's end, and nobody was told."""
    async with bench("by_tens") as b:
        pid = b.worker.pid
        assert [await failed(b, kind + n) for n in range(FAULTS_IN_A_ROW)] == [True] * FAULTS_IN_A_ROW
        down, up = await b.next(), await b.next()
        assert isinstance(down, WorkerState) and isinstance(up, WorkerState)
        assert down.detail.startswith("worker: finds no memory: ") and "LimitAS=" in down.detail
        assert (down.up, up.up, b.worker.pid != pid) == (False, True, True)
        assert [(n.text, n.data) for n in b.notices] == [("localiser restarts", (("why", down.detail),))]
        b.ask(1)
        assert isinstance(await b.next(), Fix)


async def test_one_that_finds_none_again_and_again_is_given_up_for_a_while_as_one_that_dies() -> None:
    async with bench("by_tens", max_restarts=1) as b:
        for n in range(2 * FAULTS_IN_A_ROW):
            assert await failed(b, 10 + n % 5)
            if n == FAULTS_IN_A_ROW - 1:
                await b.next(), await b.next()
        await b.next()
        (told,) = [n for n in b.notices if n.to_operator]
        assert told.text == "localiser failed, next try in 60 s" and "finds no memory" in str(told.data[0][1])


async def test_other_faults_are_told_once_and_the_worker_stays() -> None:
    async with bench("by_tens") as b:
        pid = b.worker.pid
        for _ in range(2):
            assert [await failed(b, 40 + n % 9) for n in range(2 * FAULTS_IN_A_ROW)] == [True] * 2 * FAULTS_IN_A_ROW
            assert not await failed(b, 1)
        assert b.worker.pid == pid and all(n.to_operator for n in b.notices)
        assert [n.text for n in b.notices] == ["visloc: localiser fails on all frames, see log"] * 2
        assert str(b.notices[0].data[0][1]).startswith("ZeroDivisionError: a fault (answers.py:")


def test_single_faults_are_not_spoken_of() -> None:
    faults = Faults()
    told = [faults.seen(MemoryError() if n % FAULTS_IN_A_ROW else None) for n in range(50)]
    assert told == [None] * 50
    assert [faults.seen(KeyError(n)) for n in range(6)].count(None) == 5


def test_what_says_that_there_is_no_memory() -> None:
    short = "Failed to allocate memory for requested buffer of size 6773760"
    assert is_shortage(MemoryError()) and is_shortage(ModelError(short))
    assert not is_shortage(KeyError(short)) and not is_shortage(ModelError("does not run"))
    with pytest.raises(cv2.error) as other:
        cv2.imdecode(np.zeros(0, np.uint8), cv2.IMREAD_COLOR)
    assert not is_shortage(other.value) and cv2.Error.StsNoMem == -4
