"""How long a process is waited for."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from visloc_companion.app.computer import computed_s
from visloc_companion.app.patience import STARVED_TIMES, Patience

TICKS = float(os.sysconf("SC_CLK_TCK"))


def used(root: Path, seconds: float) -> None:
    """/proc/7/stat of a process with a name that tries to mislead, which has computed for so long."""
    ticks = round(seconds * TICKS)
    file = root / "proc/7/stat"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(f"7 (a) 1 2 (b) R 1 7 7 0 -1 4194304 90 0 0 0 {ticks - ticks // 3} {ticks // 3} 0 0 30 10 1 0 99\n", "ascii")


@pytest.mark.parametrize(
    ("computed", "lasts"),
    [
        ((0.0,), False),
        ((0.5,), True),
        ((0.5, 0.5), False),
        ((2.0, 4.0, 5.1), False),
        ((5.0,), False),
        (tuple(0.1 * k for k in range(1, 6)), True),
        (tuple(0.1 * k for k in range(1, 7)), False),
    ],
)
def test_what_computes_little_is_waited_for_and_what_does_nothing_or_too_much_is_not(
    tmp_path: Path, computed: tuple[float, ...], lasts: bool
) -> None:
    assert STARVED_TIMES == 6
    used(tmp_path, 3.0)
    patience = Patience(7, 5.0, tmp_path)
    answers = []
    for seconds in computed:
        used(tmp_path, 3.0 + seconds)
        answers.append(patience.lasts())
    assert answers == [True] * (len(computed) - 1) + [lasts]


def test_where_nothing_is_known_of_the_process_it_is_not_waited_for(tmp_path: Path) -> None:
    assert not Patience(7, 5.0, tmp_path).lasts()
    (tmp_path / "proc/7").mkdir(parents=True)
    (tmp_path / "proc/7/stat").write_text("7 (cut", "ascii")
    assert computed_s(7, tmp_path) is None


def test_the_time_of_this_process_is_read() -> None:
    before = computed_s(os.getpid())
    assert before is not None
    assert before == pytest.approx(sum(os.times()[:2]), abs=0.1)
