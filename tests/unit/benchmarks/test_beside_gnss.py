from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks import beside_gnss
from benchmarks.beside_gnss import Drawn, flown, rows
from visloc_companion.types import FloatArray

TURN_S = 40.0


def flights(*, memory: bool = False) -> FloatArray:
    """(K, N, 7) of drawn flights with two turns by 120 degrees."""
    drawn = Drawn(25.0, 120.0, TURN_S, 20.0, 95.0, 0.0, 0.016, turns=2, memory=memory)
    return np.array([flown(drawn, 5000 + k) for k in range(16)])


def squared(of: FloatArray) -> float:
    """Mean squared error of the filter over what it claims since the first turn; 2 is right."""
    return float(of[:, round(TURN_S) :, 4].mean())


def test_a_filter_that_turns_errs_as_it_claims_where_the_mounting_errs_as_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    told = flights()
    assert 1.2 < squared(told) < 2.4
    assert np.max(told[:, :, 1] / told[:, :, 2]) < 0.8
    plain = beside_gnss.PositionFilter.observe
    monkeypatch.setattr(beside_gnss.PositionFilter, "observe", lambda self, fix, _: plain(self, fix))
    assert squared(flights()) > 1.2 * squared(told), "a filter that is not told what the mounting has of its fixes"


def test_what_the_navigator_knows_of_the_tilt_is_claimed() -> None:
    of = flights(memory=True)
    assert 1.2 < of[:, :, 6].mean() < 2.6
    assert np.max(of[:, :, 1] / of[:, :, 2]) < 0.9


def test_a_row_has_a_cell_for_each_column() -> None:
    drawn = Drawn(10.0, 90.0, 4.0, 3.0, 8.0, 0.0, 0.016)
    found = rows(np.array([flown(drawn, 1)]), 4.0)
    assert [len(row) for row in found] == [len(beside_gnss.COLUMNS)] * 2
    assert drawn.heading_rad(100.0) == pytest.approx(math.radians(90.0))
