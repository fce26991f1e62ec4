"""A line to the autopilot that cannot carry all that is sent is told to the operator, and shown."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.app.daemon import configuration, flight, hovering
from visloc_companion.app import live
from visloc_companion.app.slow_line import AGAIN_NS, FORGOTTEN_NS, LASTS_NS, SlowLine
from visloc_companion.types import Severity

S = 1_000_000_000


def test_a_few_that_are_left_out_at_a_start_are_not_told() -> None:
    line = SlowLine()
    assert line.seen(0, 0) is None
    assert line.seen(40, S) is None
    assert line.seen(41, S + LASTS_NS // 2) is None
    assert not line.slow
    assert line.seen(42, 3 * S + FORGOTTEN_NS) is None, "long after: it begins anew"
    assert not line.slow


def test_what_lasts_is_told_and_again_each_minute_until_it_ends() -> None:
    line, told = SlowLine(), []
    for t_s in range(100):
        notice = line.seen(3 * t_s, t_s * S)
        if notice is not None:
            told.append((t_s, notice))
    assert [t_s for t_s, _ in told] == [1 + LASTS_NS // S, 1 + (LASTS_NS + AGAIN_NS) // S]
    notice = told[0][1]
    assert (notice.severity, notice.to_operator, notice.data) == (Severity.WARNING, True, (("left_out", 9.0),))
    assert notice.text == "visloc: link too slow, messages left out"
    assert len(notice.text) <= 50
    assert line.slow
    assert line.seen(297, 100 * S + FORGOTTEN_NS) is None
    assert not line.slow


async def test_the_operator_reads_it_and_the_status_counts_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))  # for the worker process
    monkeypatch.setattr(live, "_WATCH_S", 0.05)
    async with flight(configuration(tmp_path)) as f, hovering(f):
        assert f.daemon.snapshot()["line"] == {"left_out": 0, "slow": False}

        def told() -> bool:
            f.link.left_out += 1
            return any(notice.text == "visloc: link too slow, messages left out" for notice in f.link.notices)

        await f.until(told, "a text")
        assert f.daemon.snapshot()["line"] == {"left_out": f.link.left_out, "slow": True}
        assert any("link too slow" in notice["text"] for notice in f.daemon.snapshot()["notices"])
