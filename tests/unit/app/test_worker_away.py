"""A map that is away for a while, as where its medium is pulled out or mounted anew, costs fixes for about as long."""

from __future__ import annotations

import os
import shutil
import signal
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
