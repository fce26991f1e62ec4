"""How the tests are dealt out: what a file's fixtures make is made once, and what is said to take long is there."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.distribution import APART, LONG, file_of, long_ones_first

PROJECT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def who_made_it(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for all processes, in which each that sets this file's fixtures up leaves its name."""
    base = tmp_path_factory.getbasetemp()
    process = os.environ.get("PYTEST_XDIST_WORKER")
    folder = (base if process is None else base.parent) / "distribution"
    folder.mkdir(exist_ok=True)
    (folder / (process or "alone")).touch()
    return folder


@pytest.mark.parametrize("number", range(8))
def test_a_files_fixtures_are_made_in_one_process(number: int, who_made_it: Path) -> None:
    """The groups of pytest-xdist were read by nobody, and three processes flew the flight that a file's tests share."""
    assert len(list(who_made_it.iterdir())) == 1, f"test {number}"


@pytest.mark.parametrize("file", [*APART, *LONG])
def test_what_begins_first_is_there(file: str) -> None:
    assert (PROJECT / file).is_file()
    assert file_of(f"{file}::test_a[b::c]") == file


def test_what_is_long_begins_first_and_the_rest_stays_in_its_order() -> None:
    found = [f"{LONG[0]}::test_b", "tests/z.py::test_c", f"{APART[1]}::test_d[x]", "tests/a.py::test_e", f"{APART[1]}::test_a[y]"]
    items: list[Any] = [SimpleNamespace(nodeid=nodeid) for nodeid in found]
    long_ones_first(items)
    assert [found.index(item.nodeid) for item in items] == [2, 4, 0, 1, 3]
