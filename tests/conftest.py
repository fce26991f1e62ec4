"""Shared fixtures: the folder of real data, worlds that are made once, the check that no asyncio task outlives its test."""

from __future__ import annotations

import asyncio
import fcntl
import gc
import inspect
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import cv2
import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from xdist.remote import Producer

    from tests.distribution import FilesTogether
    from visloc_companion.prepare.world import ProceduralWorld

settings.register_profile("unhurried", deadline=None)  # the machines are shared: how long an example takes says nothing
settings.load_profile("unhurried")

os.environ["ORT_DISABLE_TELEMETRY"] = "1"  # as localise/runtime.py does; some tests import onnxruntime before it
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # begun in the background of a script: programs under test would inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real data beside the project; skips where it is absent."""
    if not SHARED.is_dir():
        pytest.skip("no folder ../shared/data beside the project")
    return SHARED


@pytest.fixture(scope="session")
def kept_world(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., ProceduralWorld]:
    """`procedural_world` of seed 1, made once for all of pytest-xdist's workers: the others wait for the first."""
    from visloc_companion.prepare.world import procedural_world

    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "kept_worlds"
    folder.mkdir(exist_ok=True)

    def kept(size_m: float, **arguments: Any) -> ProceduralWorld:
        with (folder / f"{size_m:g}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            return procedural_world(1, folder, size_m=size_m, **arguments)

    return kept


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> FilesTogether | None:
    """Instead of pytest-xdist's own `--dist loadfile`."""
    from tests.distribution import FilesTogether

    return FilesTogether(config, log) if config.getvalue("dist") == "loadfile" else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """In the order in which they are dealt out; one process alone runs them as pytest-randomly has them."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        from tests.distribution import long_ones_first

        long_ones_first(items)


def pytest_collection_finish() -> None:
    """What was imported stays: no collection of garbage, and no search for tasks, need look at it again.

    What a flight notes is no garbage either: it was gone through some six hundred times in two minutes of flight. OpenCV has one
    thread, as in the worker that flies: there are several processes of tests.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 50, 50)
    cv2.setNumThreads(1)


@pytest.fixture(autouse=True)
def no_leaked_tasks(request: pytest.FixtureRequest) -> Iterator[None]:
    """An asynchronous test that leaves a task unfinished fails (a synchronous one has no loop that outlives a call)."""
    yield
    if not inspect.iscoroutinefunction(getattr(request, "function", None)):
        return
    gc.collect()
    leaked = [task for task in gc.get_objects() if _is_pending_task(task)]
    assert not leaked, f"tasks left unfinished: {leaked}"


def _is_pending_task(thing: object) -> bool:
    if not issubclass(type(thing), asyncio.Task):  # isinstance would ask the object, and some of PyTorch's warn when asked
        return False
    task = cast("asyncio.Task[object]", thing)
    return not task.done() and not task.get_loop().is_running()


@pytest.fixture(autouse=True)
def strict_outbox(monkeypatch: pytest.MonkeyPatch) -> None:
    """In flight a message that must never be sent is dropped and counted; here it fails the test."""
    from visloc_companion.adapters.mavlink.outbox import Outbox

    monkeypatch.setattr(Outbox, "strict", True)
