"""Cells over which soundings are taken together: as small as their number allows, and smaller yet over wide ground."""

from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.localise.terrain.cells import MOST_CELLS, MOST_WIDE_CELLS, cells_of
from visloc_companion.types import FloatArray


def swath(length_m: float) -> FloatArray:
    """(N, 2) places of a swath of 600 m, one for each 10 m."""
    north, east = np.meshgrid(np.arange(0.0, length_m, 10.0), np.arange(0.0, 600.0, 10.0))
    return np.column_stack([north.ravel(), east.ravel()])


@pytest.mark.parametrize(
    ("length_m", "most"), [(300.0, MOST_CELLS), (1500.0, MOST_CELLS), (3000.0, MOST_WIDE_CELLS), (12e3, MOST_WIDE_CELLS)]
)
def test_there_are_no_more_cells_than_a_covariance_is_made_of(length_m: float, most: int) -> None:
    cells = cells_of(swath(length_m))
    assert most / 2 < len(cells.at_m) <= most
    assert np.bincount(cells.of).sum() == len(swath(length_m))


def test_cells_over_some_kilometres_are_hardly_wider_than_what_ground_is_told_by() -> None:
    cells = cells_of(swath(5000.0))
    side_m = np.sqrt(5000.0 * 600.0 / len(cells.at_m))
    assert side_m < 50.0
