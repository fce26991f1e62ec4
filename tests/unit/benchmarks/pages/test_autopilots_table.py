"""The table of the flights against real simulators, from rows that are made by hand."""

from __future__ import annotations

import importlib
import json
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
ROW = {
    "simulator": "px4", "flight": "jam", "seed": 1, "speed": 2.0, "commit": "abc1234", "version": "px4 1 02e7", "vision_s": 298.0,
    "error_p95_m": 2.5, "error_max_m": 3.1, "gnss_p95_m": None, "velocity_rms_mps": 0.7, "rejected_share": 0.0, "failsafes": [],
    "wrong_source_s": 0.0, "pulled_m": None, "gap_s": 0.12, "settled_s": float("inf"), "built_in_p95_m": 1.4, "judged": True,
    "missed": [],
}  # fmt: skip


@pytest.fixture
def module(monkeypatch):
    """benchmarks/ is no part of the installed package."""
    monkeypatch.syspath_prepend(str(ROOT))
    return importlib.import_module("benchmarks.pages.autopilots_table")


def test_rows_stand_in_the_order_of_simulators_and_flights(module, tmp_path: Path) -> None:
    for simulator, flight in (("px4", "late"), ("px4", "jam"), ("arducopter", "late")):
        path = module.row_path(tmp_path, simulator, flight, 1)
        path.write_text(json.dumps({**ROW, "simulator": simulator, "flight": flight}))
    rows = [(row["simulator"], row["flight"]) for row in module.read_rows(tmp_path)]
    assert rows == [("arducopter", "late"), ("px4", "jam"), ("px4", "late")]


def test_a_built_in_figure_more_than_a_third_off_is_bold(module) -> None:
    assert "| **1.4** |" in module.table([ROW])
    assert "| 2.0 |" in module.table([{**ROW, "built_in_p95_m": 2.0}])


@pytest.mark.parametrize(
    ("changed", "shown"),
    [
        ({"odometry": True}, "yes"),
        ({"odometry": False}, "no"),
        ({}, "no"),
        ({"flight": "rendered"}, "yes"),
        ({"flight": "without_daemon", "judged": False}, ""),
    ],
)
def test_a_row_says_whether_its_answers_brought_odometry(module, changed: dict[str, object], shown: str) -> None:
    line = module.table([{**ROW, **changed}]).splitlines()[2]
    assert line.split("|")[3].strip() == shown


def test_a_flight_that_nobody_helped_shows_how_far_it_strayed(module) -> None:
    alone = {**ROW, "flight": "without_daemon", "judged": False, "error_max_m": None, "error_p95_m": None, "strayed_m": 123.4}
    assert module.table([alone]).splitlines()[2].split("|")[6].strip() == "123.4"


def test_what_was_missed_and_what_never_came_is_said(module) -> None:
    line = module.table([{**ROW, "missed": ["95 %"]}]).splitlines()[2]
    assert "| never |" in line
    assert "| **no** |" in line
    assert len(line.split("|")) == len(module.HEADER.split("|"))
    failed = module.table([{"simulator": "px4", "flight": "jam", "error": "no\nheartbeat\n"}]).splitlines()[2]
    assert "not flown: no heartbeat" in failed
    assert len(failed.split("|")) == len(module.HEADER.split("|"))


def test_the_page_keeps_what_stands_around_the_table(module) -> None:
    page = f"before\n{module.BEGIN}\nold\n{module.END}\nafter\n"
    new = module.written(page, [ROW])
    assert new.startswith("before\n")
    assert new.endswith(f"{module.END}\nafter\n")
    assert "old" not in new
    assert "Programs: PX4 quadrotor: px4 1 02e7." in new
