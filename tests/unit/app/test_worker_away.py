"""A map that is away for a while, as where its medium is pulled out or mounted anew, costs fixes for about as long."""

from __future__ import annotations

import asyncio
import os
import shutil
import signal
import threading
from pathlib import Path

import pytest

from tests.unit.app.test_worker import Bench, _answers_can_be_imported, bench  # noqa: F401 - the fixture
from visloc_companion.app import worker as supervisor_module
from visloc_companion.types import Fix, WorkerState

VAIN_S = 0.4


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor_module, "_VAIN_S", VAIN_S)


def pack(tmp_path: Path) -> Path:
    (tmp_path / "pack").mkdir()
    (tmp_path / "pack" / "ortho.tif").write_bytes(b"pixels")
    return tmp_path / "pack"


async def downs_until_up(b: Bench, then: int, back: object) -> list[str]:
    """Why each worker ended until one is up again; after `then` of them the map is brought back."""
    details: list[str] = []
    while not isinstance(state := await b.next(), WorkerState) or not state.up:
        if isinstance(state, WorkerState):
            details.append(state.detail)
        if len(details) == then and callable(back):
            back()
    return details


async def test_a_map_that_is_away_for_a_moment_uses_up_no_restarts(tmp_path: Path) -> None:
    folder, away = pack(tmp_path), tmp_path / "away"
    async with bench("needs_its_pack", pack=str(folder)) as b:
        assert b.worker.pid is not None
        shutil.move(folder, away)
        os.kill(b.worker.pid, signal.SIGBUS)  # what reading a mapped file of a medium that is gone comes to
        details = await downs_until_up(b, 3, lambda: shutil.move(away, folder))
        assert details == ["the worker ended with signal 7", *["pack: is away"] * 2]
        assert not b.worker.given_up
        assert [n.text for n in b.notices] == ["localiser restarts"] * 3
        assert not [n for n in b.notices if n.to_operator]
        b.ask(10)
        assert isinstance(await b.next(), Fix)


async def test_a_map_that_is_away_for_longer_is_told_and_tried_again_ever_later(tmp_path: Path) -> None:
    folder, away = pack(tmp_path), tmp_path / "away"
    async with bench("needs_its_pack", pack=str(folder), max_restarts=2) as b:
        assert b.worker.pid is not None
        shutil.move(folder, away)
        os.kill(b.worker.pid, signal.SIGBUS)
        details = await downs_until_up(b, 4, lambda: shutil.move(away, folder))
        assert details[2:] == ["given up: pack: is away"] * 2
        told = [n for n in b.notices if n.to_operator]
        assert [n.text for n in told] == [f"map cannot be opened, next try in {2 * VAIN_S:.0f} s", "localiser is back"]
        assert dict(told[0].data)["why"] == "pack: is away"
        assert len("map cannot be opened, next try in 60 s") <= 50
        b.ask(10)
        assert isinstance(await b.next(), Fix)


async def test_a_medium_that_hangs_holds_nothing_up_and_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A network's or a FUSE file system whose other end is gone lets nobody look at a file, and says nothing."""
    stamps, answers, looked = supervisor_module.file_stamps, threading.Event(), threading.Event()

    def hangs(folder: str) -> supervisor_module.FileStamps:
        looked.set()
        answers.wait(30)
        return stamps(folder)

    monkeypatch.setattr(supervisor_module, "_LOOK_S", 0.2)
    async with bench("needs_its_pack", pack=str(pack(tmp_path))) as b:
        assert b.worker.pid is not None
        monkeypatch.setattr(supervisor_module, "file_stamps", hangs)
        os.kill(b.worker.pid, signal.SIGKILL)
        details = [state.detail for state in (await b.next(), await b.next()) if isinstance(state, WorkerState)]
        assert details == ["the worker ended with signal 9", "the map pack's medium does not answer"]
        assert looked.is_set() and not answers.is_set()  # this goes on meanwhile
        assert [n.text for n in b.notices if n.to_operator] == ["map pack's medium hangs"]
        assert not b.worker.overdue
        answers.set()
        assert await downs_until_up(b, 1, None) == []
        b.ask(10)
        assert isinstance(await b.next(), Fix)


async def test_and_does_not_keep_the_daemon_from_ending(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answers = threading.Event()
    async with bench("needs_its_pack", pack=str(pack(tmp_path))) as b:
        assert b.worker.pid is not None
        monkeypatch.setattr(supervisor_module, "file_stamps", lambda _: (answers.wait(30), ())[1])
        os.kill(b.worker.pid, signal.SIGKILL)
        await b.next()
        await b.worker.close()
        answers.set()
        await asyncio.sleep(0.1)
        assert b.worker.pid is None
