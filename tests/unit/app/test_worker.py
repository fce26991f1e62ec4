"""The worker and its supervisor, with real processes."""

from __future__ import annotations

import asyncio
import errno
import os
import signal
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from multiprocessing import shared_memory
from multiprocessing.context import SpawnProcess
from pathlib import Path

import numpy as np
import pytest

from visloc_companion.app import worker as supervisor_module
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.app.slots import SharedFrameSlots
from visloc_companion.app.worker import WorkerSupervisor, file_stamps
from visloc_companion.app.worker_process import load_factory
from visloc_companion.config import Config, parse_config
from visloc_companion.errors import HashMismatch, Reason, VislocError, WorkerError
from visloc_companion.types import (
    CameraModel,
    Fix,
    FrameRef,
    GeoPoint,
    LocaliseRequest,
    NoFix,
    Notice,
    PosePrior,
    TerrainRequest,
    WorkerState,
)

MODEL = CameraModel(64, 48, 50.0, 50.0, 31.5, 23.5)
PRIOR = PosePrior(GeoPoint(47.0, 8.0, 500.0), (1.0, 0.0, 0.0, 0.0), ((4.0, 0.0), (0.0, 4.0)), 2.0, 0.1, 0.02)


@dataclass
class Bench:
    slots: SharedFrameSlots
    worker: WorkerSupervisor
    notices: list[Notice] = field(default_factory=list)
    frames: int = 0

    def ask(self, request_id: int) -> LocaliseRequest:
        self.frames += 1
        frame = FrameRef(
            0, 1000 * self.frames, self.frames, self.slots.write(np.full((48, 64), self.frames, np.uint8)), 64, 48, 1
        )
        self.slots.announce(frame)
        request = LocaliseRequest(request_id, frame, PRIOR, 1)
        self.worker.submit(request)
        return request

    async def next(self) -> Fix | NoFix | WorkerState:
        return await asyncio.wait_for(self.worker.events.get(), 60)


@pytest.fixture(autouse=True)
def _answers_can_be_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))


@asynccontextmanager
async def bench(
    factory: str, start: bool = True, pack: str = "", known: str = "", verify: bool = True, **worker: float
) -> AsyncIterator[Bench]:
    config: Config = parse_config({"worker": worker, "map": {"pack": pack, "verify_hashes": verify}})
    notices: list[Notice] = []
    with SharedFrameSlots(MODEL) as slots:
        supervisor = WorkerSupervisor(
            config, slots, MonotonicClock(), on_notice=notices.append, factory=f"answers:{factory}", known=known
        )
        try:
            if start:
                await supervisor.start()
                state = await supervisor.events.get()
                assert isinstance(state, WorkerState)
                assert (state.up, state.restarts) == (True, 0)
            yield Bench(slots, supervisor, notices)
        finally:
            await supervisor.close()


async def test_a_request_is_answered_from_the_pixels_with_the_arrival_time() -> None:
    async with bench("prior_is_right", nice=5) as b:
        before = MonotonicClock().now_ns()
        b.ask(10)
        b.ask(11)  # while it is busy: declined, never queued
        declined, fix = await b.next(), await b.next()
        assert isinstance(declined, NoFix)
        assert (declined.request_id, declined.reason, declined.detail) == (11, Reason.SUPERSEDED, "the worker is busy")
        assert isinstance(fix, Fix)
        assert (fix.request_id, fix.frame_id, fix.t_ns) == (10, 1, 1000)
        assert before < fix.t_rx_ns <= MonotonicClock().now_ns()
        evidence = dict(fix.evidence)
        assert evidence["mean"] == 1.0
        assert evidence["threads"] == 1.0
        assert evidence["nice"] == min(19, os.nice(0) + 5)


async def test_a_network_that_another_provider_took_over_is_told_before_its_first_answer() -> None:
    async with bench("leaving") as b:
        for request_id in (10, 20, 30):
            b.ask(request_id)
            assert isinstance(await b.next(), Fix)
            assert len(b.notices) == (request_id > 10)
    (notice,) = b.notices
    assert (notice.text, notice.to_operator) == ("localiser: network on another provider", True)
    assert notice.data == (("now", "on cpu; passed over cuda: lost"),)


async def test_a_frame_that_was_overwritten_is_superseded() -> None:
    async with bench("prior_is_right") as b:
        old = b.ask(10)
        assert isinstance(await b.next(), Fix)
        for value in range(4):
            b.slots.write(np.full((48, 64), value, np.uint8))
        b.worker.submit(old)
        answer = await b.next()
        assert isinstance(answer, NoFix)
        assert (answer.reason, answer.detail) == (Reason.SUPERSEDED, "a newer frame took the slot")


async def test_a_killed_worker_is_noticed_answered_and_replaced() -> None:
    async with bench("by_request_id") as b:
        assert b.worker.pid is not None
        b.ask(1)  # would take a minute
        os.kill(b.worker.pid, signal.SIGKILL)
        answer, down, up = await b.next(), await b.next(), await b.next()
        assert isinstance(answer, NoFix)
        assert (answer.request_id, answer.reason) == (1, Reason.WORKER_DIED)
        assert isinstance(down, WorkerState)
        assert (down.up, down.restarts, down.detail) == (False, 1, "the worker ended with signal 9")
        assert isinstance(up, WorkerState)
        assert (up.up, up.restarts) == (True, 1)
        b.ask(10)
        assert isinstance(await b.next(), Fix)
        assert [notice.text for notice in b.notices] == ["localiser restarts"]


async def test_a_worker_that_is_killed_while_idle() -> None:
    async with bench("by_request_id") as b:
        assert b.worker.pid is not None
        os.kill(b.worker.pid, signal.SIGKILL)
        states = [await b.next(), await b.next()]
        assert [isinstance(state, WorkerState) and state.up for state in states] == [False, True]


async def test_a_deadline_that_passes_kills_and_restarts() -> None:
    async with bench("by_request_id", deadline_s=0.3) as b:
        pid = b.worker.pid
        b.ask(1)
        answer, down, up = await b.next(), await b.next(), await b.next()
        assert isinstance(answer, NoFix)
        assert (answer.reason, answer.detail) == (Reason.WORKER_TIMEOUT, "a localisation took longer than 0.3 s")
        assert isinstance(down, WorkerState)
        assert isinstance(up, WorkerState)
        assert (down.up, up.up) == (False, True)
        assert b.worker.pid != pid
        with pytest.raises(ProcessLookupError):
            os.kill(pid or 0, 0)


async def test_a_localisation_that_lacks_a_core_is_waited_for() -> None:
    async with bench("by_request_id", deadline_s=1.0) as b:  # the answer takes 2.2 s, of which it computes for 0.3 s
        pid = b.worker.pid
        b.ask(7)
        answer = await b.next()
        assert isinstance(answer, Fix)
        assert (b.worker.pid, b.worker.restarts) == (pid, 0)


async def test_one_that_computes_for_ever_is_not() -> None:
    async with bench("by_request_id", deadline_s=0.4) as b:
        b.ask(8)
        answer = await b.next()
        assert isinstance(answer, NoFix)
        assert answer.reason is Reason.WORKER_TIMEOUT


async def test_too_many_deaths_give_up_and_tell_the_operator() -> None:
    async with bench("by_request_id", max_restarts=1) as b:
        b.ask(2)
        assert isinstance(await b.next(), NoFix)
        assert [isinstance(state, WorkerState) and state.up for state in (await b.next(), await b.next())] == [False, True]
        b.ask(4)
        answer, down = await b.next(), await b.next()
        assert isinstance(answer, NoFix)
        assert answer.detail == "the worker ended with exit code 7"
        assert isinstance(down, WorkerState)
        assert (down.up, down.restarts, down.detail) == (False, 2, "given up: the worker ended with exit code 7")
        assert b.worker.given_up
        assert not b.worker.alive
        assert b.notices[-1].text == "localiser failed, next try in 60 s"
        assert b.notices[-1].to_operator
        assert len(b.notices[-1].text) <= 50
        b.ask(10)
        late = await b.next()
        assert isinstance(late, NoFix)
        assert (late.reason, late.detail) == (Reason.WORKER_DIED, "there is no worker")


async def test_what_was_given_up_is_tried_again_and_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor_module, "_PAUSE_S", 0.05)
    async with bench("by_request_id", max_restarts=1) as b:
        for request_id in (2, 2):
            b.ask(request_id)
            while not isinstance(state := await b.next(), WorkerState) or "signal 9" not in state.detail:
                pass
            again = await b.next()
            assert isinstance(again, WorkerState)
            assert again.up
        assert [notice.text for notice in b.notices][-1] == "localiser is back"
        assert b.notices[-1].to_operator
        assert b.worker.alive
        b.ask(10)
        assert isinstance(await b.next(), Fix)


@pytest.mark.parametrize("failures", [1, 3])
async def test_a_system_without_memory_for_another_worker_is_asked_again(monkeypatch: pytest.MonkeyPatch, failures: int) -> None:
    """What killed the worker, as the kernel does for want of memory, may keep the next one from being started."""
    monkeypatch.setattr(supervisor_module, "_PAUSE_S", 0.05)
    monkeypatch.setattr(supervisor_module, "_SCARCE_S", 0.05)
    start, tried = SpawnProcess.start, list[int]()

    def scarce(process: SpawnProcess) -> None:
        tried.append(sum(1 for _ in Path("/proc/self/fd").iterdir()))
        if len(tried) <= failures:
            raise OSError(errno.ENOMEM, "Cannot allocate memory")
        start(process)

    async with bench("prior_is_right", max_restarts=2) as b:
        assert b.worker.pid is not None
        monkeypatch.setattr(SpawnProcess, "start", scarce)
        os.kill(b.worker.pid, signal.SIGKILL)
        details = []
        while not isinstance(state := await b.next(), WorkerState) or not state.up:
            details.append(getattr(state, "detail", ""))
        assert "no worker can be started: Cannot allocate memory" in details[-1]
        assert len(details) == failures + 1
        assert len(set(tried)) == 1, "no descriptor is left behind"
        assert ("localiser failed, next try in 0 s" in [n.text for n in b.notices if n.to_operator]) is (failures == 3)
        b.ask(10)
        assert isinstance(await b.next(), Fix)


async def test_a_pack_that_was_written_to_is_verified_anew_when_a_worker_restarts(tmp_path: Path) -> None:
    (tmp_path / "ortho.tif").write_bytes(b"as verified")
    async with bench("starts_once", pack=str(tmp_path)) as b:  # its later starts fail unless they are told to verify
        assert b.worker.pid is not None
        (tmp_path / "ortho.tif").write_bytes(b"written to in flight")
        os.kill(b.worker.pid, signal.SIGKILL)
        states = [await b.next(), await b.next()]
        assert [isinstance(state, WorkerState) and state.up for state in states] == [False, True]
        assert "changed since the start" in b.notices[-1].text


async def test_a_pack_that_the_daemon_before_has_verified_is_not_verified_again(tmp_path: Path) -> None:
    """Hashes take seconds a gigabyte, and PX4's failsafe comes after 4.6 s; one that is another by now is not taken for it."""
    (tmp_path / "ortho.tif").write_bytes(b"as verified")
    async with bench("starts_once", pack=str(tmp_path)) as b:
        known = b.worker.pack_seal
    with pytest.raises(HashMismatch):  # the stand-in for a worker that was told not to verify
        async with bench("starts_once", pack=str(tmp_path), known=known):
            pass
    (tmp_path / "ortho.tif").write_bytes(b"exchanged since")
    async with bench("starts_once", pack=str(tmp_path), known=known) as b:
        assert b.worker.pack_seal not in ("", known)


async def test_a_pack_that_nobody_verified_passes_for_no_verified_one(tmp_path: Path) -> None:
    (tmp_path / "ortho.tif").write_bytes(b"a")
    async with bench("prior_is_right", pack=str(tmp_path), verify=False) as b:
        assert b.worker.pack_seal == ""
    async with bench("prior_is_right") as b:
        assert b.worker.pack_seal == ""


def test_a_replaced_file_has_another_stamp(tmp_path: Path) -> None:
    (tmp_path / "levels").mkdir()
    (tmp_path / "levels" / "0.npy").write_bytes(b"a")
    before = file_stamps(str(tmp_path))
    (tmp_path / "new").write_bytes(b"b")
    (tmp_path / "new").replace(tmp_path / "levels" / "0.npy")
    assert file_stamps(str(tmp_path)) != before
    assert file_stamps("") == file_stamps(str(tmp_path / "none")) == ()


async def test_a_restart_that_fails_counts_as_a_death() -> None:
    async with bench("starts_once", max_restarts=1) as b:
        b.ask(2)
        answer, first, second = await b.next(), await b.next(), await b.next()
        assert isinstance(answer, NoFix)
        assert isinstance(first, WorkerState)
        assert isinstance(second, WorkerState)
        assert second.detail == "given up: pack: is gone"


async def test_a_fault_in_one_frame_costs_that_frame_only() -> None:
    async with bench("by_request_id") as b:
        pid = b.worker.pid
        b.ask(3)
        answer = await b.next()
        assert isinstance(answer, NoFix)
        assert answer.reason is Reason.BAD_INPUT
        assert answer.detail.startswith("ZeroDivisionError: a fault (answers.py:")
        b.ask(6)
        declined = await b.next()
        assert isinstance(declined, NoFix)
        assert declined.reason is Reason.NO_MATCH
        assert b.worker.pid == pid


@pytest.mark.parametrize(
    ("factory", "kind", "what"),
    [
        ("broken_pack", HashMismatch, "pack/ortho.tif: differs from the manifest; remedy: copy the pack again"),
        ("bug_at_start", WorkerError, "cannot start: KeyError: 'surprise'"),
        ("dies_at_start", WorkerError, "the worker ended with signal 9"),
        ("no_such", WorkerError, "no function 'answers:no_such'"),
    ],
)
async def test_what_stands_against_the_start_is_raised(factory: str, kind: type[VislocError], what: str) -> None:
    async with bench(factory, start=False) as b:
        with pytest.raises(kind, match=what):
            await b.worker.start()
        assert b.worker.pid is None
        assert len(b.worker.events) == 0


async def test_close_ends_a_worker_that_computes_and_the_memory_goes() -> None:
    async with bench("by_request_id") as b:
        pid, name = b.worker.pid, b.slots.name.name
        b.ask(1)
        await asyncio.sleep(0.05)
    assert pid is not None
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    with pytest.raises(FileNotFoundError):
        shared_memory.SharedMemory(name=name)


async def test_the_workers_group_signals_do_not_end_it() -> None:
    async with bench("by_request_id") as b:
        assert b.worker.pid is not None
        for number in (signal.SIGINT, signal.SIGTERM):
            os.kill(b.worker.pid, number)
        b.ask(5)
        assert isinstance(await b.next(), Fix)


@pytest.mark.parametrize("after_s", [0.0, 0.05, 0.3])
async def test_nor_do_they_while_it_starts(after_s: float) -> None:
    """Ctrl-C goes to the worker, too: the daemon ends it, and not a traceback of its own."""
    async with bench("by_request_id", start=False) as b:
        b.worker.begin()
        await asyncio.sleep(after_s)
        assert b.worker.pid is not None
        for number in (signal.SIGINT, signal.SIGTERM):
            os.kill(b.worker.pid, number)
        await b.worker.start()
        assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


async def test_a_start_that_is_cancelled_leaves_no_process() -> None:
    async with bench("prior_is_right", start=False) as b:
        task = asyncio.create_task(b.worker.start())
        await asyncio.sleep(0.01)
        pid = b.worker.pid
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert pid is not None
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_a_factory_is_named_by_module_and_function() -> None:
    factory: Callable[..., object] = load_factory("visloc_companion.app.worker_process:open_localiser")
    assert factory.__name__ == "open_localiser"
    with pytest.raises(WorkerError, match="no function 'nowhere:f'"):
        load_factory("nowhere:f")


async def test_a_question_about_the_ground_needs_no_frame_and_is_answered_where_there_is_no_map() -> None:
    async with bench("prior_is_right") as b:
        b.worker.submit(TerrainRequest(5, 77, PRIOR, 0.5, 0.01, 0.0, (), final=True))
        answer = await b.next()
    assert isinstance(answer, NoFix)
    assert (answer.request_id, answer.t_ns, answer.method, answer.reason) == (5, 77, "terrain", Reason.OUTSIDE_MAP)
