"""The made-up flight, for tests of figures and reports, and processes that are killed."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from visloc_companion.evaluate import batch


def load_synthetic() -> ModuleType:
    name = "visloc_tests_synthetic_flight"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, Path(__file__).parent / "synthetic_flight.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return sys.modules[name]


@pytest.fixture(scope="session")
def synthetic() -> ModuleType:
    return load_synthetic()


class DyingPool(ThreadPoolExecutor):
    """A pool that is broken after its first result."""

    def __init__(self, jobs: int, mp_context: object, initializer: object, initargs: object) -> None:
        super().__init__(jobs)

    def map(self, work: Callable[[Any], Any], items: Sequence[Any], **_: object) -> Iterator[Any]:
        yield work(items[0])
        raise BrokenProcessPool


@pytest.fixture
def dying_pool(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch, "ProcessPoolExecutor", DyingPool)
