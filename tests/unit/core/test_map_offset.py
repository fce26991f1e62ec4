from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.core.map_offset import FEWEST, MapOffset
from visloc_companion.types import Notice

S = 1_000_000_000


def after(offset_m: float, n: int = 60, seed: int = 1) -> MapOffset:
    rng = np.random.default_rng(seed)
    known = MapOffset(0.5)
    for k in range(n):
        north, east = 1.0 * rng.standard_normal(2)
        known.compared(k * S, (float(north), offset_m + float(east)))
    return known


def test_what_gnss_explains_changes_nothing() -> None:
    for offset_m in (0.0, 3.0, 5.5):
        known = after(offset_m)
        assert known.sigma_m == 0.5
        assert known.notices() == []


def test_a_shift_beyond_that_is_told_once_and_widens_what_the_map_says() -> None:
    known = after(8.0)
    assert known.sigma_m == pytest.approx(4.0, abs=0.3)
    (told,) = known.notices()
    assert isinstance(told, Notice)
    assert told.text == "visloc: map is 8 m off GNSS"
    assert len(told.text.encode()) <= 50
    assert known.notices() == []


def test_a_few_differences_tell_nothing() -> None:
    assert after(8.0, FEWEST - 1).sigma_m == 0.5
    assert after(8.0, FEWEST).sigma_m > 3


def test_only_the_last_two_minutes_count() -> None:
    known = after(20.0, 60)
    for k in range(180, 220):
        known.compared(k * S, (0.0, 0.0))
    assert known.sigma_m == 0.5


def test_a_drag_that_was_found_is_not_the_maps() -> None:
    known = after(0.0, 60)
    for k in range(60, 90):
        known.compared(k * S, (1.0 * (k - 60), 0.0))
    known.suspected(90 * S)
    assert known.sigma_m == 0.5
    assert known.distance_m < 1.0
