from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.core.map_offset import BORNE_OUT_BY, FEWEST, MOST_M, MapOffset
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


def test_a_few_differences_tell_nothing_of_a_map_that_was_borne_out() -> None:
    known = after(0.0, BORNE_OUT_BY)
    for k in range(FEWEST):
        known.compared((200 + k) * S, (0.0, 8.0))
        assert known.sigma_m == (0.5 if k < FEWEST - 1 else 4.0)


def never_agreed(offset_m: float, n: int) -> MapOffset:
    """The second fix beside GNSS already has it suspect."""
    known = MapOffset(0.5)
    known.compared(0, (0.0, offset_m))
    for k in range(1, n):
        known.suspected(1 * S, k * S, (0.0, offset_m))
    return known


def test_a_gnss_that_never_agreed_with_the_map_may_be_right() -> None:
    assert never_agreed(30.0, BORNE_OUT_BY - 1).sigma_m == 0.5
    known = never_agreed(30.0, BORNE_OUT_BY)
    assert known.sigma_m == pytest.approx(15.0)
    (told,) = known.notices()
    assert isinstance(told, Notice)
    assert told.text == "visloc: map is 30 m off GNSS"


def test_no_map_is_off_by_more_than_tens_of_metres() -> None:
    assert never_agreed(MOST_M - 1, 60).sigma_m > 20
    assert never_agreed(MOST_M + 1, 60).sigma_m == 0.5


def test_a_gnss_that_agreed_and_was_led_away_is_wrong() -> None:
    known = after(0.0, 60)
    for k in range(60, 120):
        known.suspected(60 * S, k * S, (0.0, 30.0))
    assert known.sigma_m == 0.5


def test_only_the_last_two_minutes_count() -> None:
    known = after(20.0, 60)
    for k in range(180, 220):
        known.compared(k * S, (0.0, 0.0))
    assert known.sigma_m == 0.5


def test_a_drag_that_was_found_is_not_the_maps() -> None:
    known = after(0.0, 60)
    for k in range(60, 90):
        known.compared(k * S, (1.0 * (k - 60), 0.0))
    known.suspected(90 * S, 90 * S, (30.0, 0.0))
    assert known.sigma_m == 0.5
    assert known.distance_m < 1.0
