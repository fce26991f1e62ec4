"""What one ground as one witness costs and saves, as the benchmark counts it."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def witness(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    return importlib.import_module("benchmarks.gnss_witness")


def test_a_handful_of_flights_makes_a_table_of_both(witness, capsys):
    assert witness.main(["--clean", "2", "--clean-s", "60", "--drags", "2", "--thresholds", "9", "100", "--claim", "0.05"]) == 0
    rows = [line.split("|")[1:-1] for line in capsys.readouterr().out.splitlines()[2:]]
    assert [(row[0].strip(), float(row[1])) for row in rows] == [
        ("each fix", 9.0),
        ("each fix", 100.0),
        ("each ground", 9.0),
        ("each ground", 100.0),
    ]
    assert rows[1][2].strip() == "0.00 (0 in 0.0333333 h)"
    each_fix, each_ground = (float(row[3].split(",")[0]) for row in (rows[0], rows[2]))
    assert each_fix <= each_ground


def test_what_is_counted_of_a_flight(witness):
    log_r = np.full(180, -1.0)
    log_r[[50, 51, 134]] = 11.0
    series = witness.Series({"vision": log_r}, np.zeros(180))
    assert witness.after_s(series, 10.5) == 14.0
    assert witness.after_s(series, 12.0) == witness.WATCHED_S
    assert witness.rows([series], [series], [10.5]) == ["10.5 | 400.00 (2 in 0.05 h) | 14.0, 14.0, 14.0 |"]
