from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from visloc_companion.core.satellites.map_offset import BORNE_OUT_BY, FEWEST, MOST_M, Beside, MapOffset, median
from visloc_companion.types import Notice

S = 1_000_000_000


def after(offset_m: float, n: int = 60, seed: int = 1) -> MapOffset:
    rng = np.random.default_rng(seed)
    known = MapOffset(0.5)
    for k in range(n):
        north, east = 1.0 * rng.standard_normal(2)
        known.compared(Beside(k * S, (float(north), offset_m + float(east))))
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


def high_up(offset_m: float, claim_m: float, n: int, speed_mps: float = 10.0) -> MapOffset:
    """750 m above a map of 5 m a pixel, a fix a second."""
    known = MapOffset(2.5)
    for k in range(n):
        known.compared(Beside(k * S, (0.0, offset_m), (speed_mps, 0.0), (0.0, 0.0), 2 * claim_m**2, 450.0))
    return known


def test_what_fixes_claim_to_be_off_by_in_common_is_no_shift_of_the_map() -> None:
    known = high_up(9.0, 8.7, 30)
    assert (known.distance_m, known.sigma_m, known.notices()) == (9.0, 2.5, [])
    assert high_up(9.0, 0.7, 30).sigma_m > 4.4, "fixes that claim to be better"


def test_a_shift_of_more_than_that_widens_what_the_map_says_by_the_rest() -> None:
    by_claim = [high_up(20.0, claim_m, 30).sigma_m for claim_m in (0.0, 4.0, 8.7)]
    assert by_claim == sorted(by_claim, reverse=True)
    assert by_claim[0] == 10.0
    assert by_claim[-1] > 8.0


def test_over_more_ground_claims_explain_less_of_a_difference_that_stays() -> None:
    assert high_up(11.0, 8.7, 30).sigma_m == 2.5
    assert high_up(11.0, 8.7, 110).sigma_m > 3.9
    assert high_up(11.0, 8.7, 110, speed_mps=0.0).sigma_m == 2.5


def test_a_few_differences_tell_nothing_of_a_map_that_was_borne_out() -> None:
    known = after(0.0, BORNE_OUT_BY)
    for k in range(FEWEST):
        known.compared(Beside((200 + k) * S, (0.0, 8.0)))
        assert known.sigma_m == (0.5 if k < FEWEST - 1 else 4.0)


@pytest.mark.parametrize("jumped_m", [MOST_M + 1.0, 2000.0, 20_000.0])
def test_a_gnss_that_jumped_further_than_maps_lie_tells_nothing_of_the_map(jumped_m: float) -> None:
    """It is trusted for seconds still: 2 km had the map 32 m off with the first fix, and the vehicle lost with the fourth."""
    known = after(0.0)
    for k in range(10):
        known.compared(Beside((60 + k) * S, (0.0, jumped_m), (0.1, 0.0)))
    assert known.sigma_m == 0.5
    assert known.notices() == []


def never_agreed(offset_m: float, n: int) -> MapOffset:
    """The second fix beside GNSS already has it suspect."""
    known = MapOffset(0.5)
    known.compared(Beside(0, (0.0, offset_m)))
    for k in range(1, n):
        known.suspected(1 * S, Beside(k * S, (0.0, offset_m)))
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
        known.suspected(60 * S, Beside(k * S, (0.0, 30.0)))
    assert known.sigma_m == 0.5


def test_only_the_last_two_minutes_count() -> None:
    known = after(20.0, 60)
    for k in range(180, 220):
        known.compared(Beside(k * S, (0.0, 0.0)))
    assert known.sigma_m == 0.5


def test_a_drag_that_was_found_is_not_the_maps() -> None:
    known = after(0.0, 60)
    for k in range(60, 90):
        known.compared(Beside(k * S, (1.0 * (k - 60), 0.0)))
    known.suspected(90 * S, Beside(90 * S, (30.0, 0.0)))
    assert known.sigma_m == 0.5
    assert known.distance_m < 1.0


@pytest.mark.parametrize("n", [16, 36])
def test_a_gnss_that_jumps_early_in_a_flight_says_nothing_of_the_map_before_it_is_suspect(n: int) -> None:
    """Five fixes beside one that has jumped by 80 m said that the map is 10 m off GNSS, when neither is."""
    known = after(0.0, n)
    for k in range(n, n + 5):
        known.compared(Beside(k * S, (80.0, 0.0), (10.0, 0.0)))
        assert known.notices() == []
        assert known.sigma_m == 0.5


def lagging(lag_s: float, course_deg: Callable[[int], float], n: int = 60, map_north_m: float = 0.0) -> MapOffset:
    """Fixes lag behind GNSS at 10 m/s, over a map that lies to the north."""
    rng, known = np.random.default_rng(2), MapOffset(0.5)
    for k in range(n):
        v = 10 * np.array((math.cos(math.radians(course_deg(k))), math.sin(math.radians(course_deg(k)))))
        north, east = (lag_s * v + (map_north_m, 0.0) + rng.standard_normal(2)).tolist()
        known.compared(Beside(k * S, (north, east), (float(v[0]), float(v[1]))))
    return known


def texts(known: MapOffset, *, delay_told: bool = False) -> list[str]:
    return [n.text for n in known.notices(delay_told=delay_told) if isinstance(n, Notice)]


def test_what_goes_round_with_the_course_is_a_delay_and_stays_in_the_level() -> None:
    there_and_back = lagging(1.0, lambda k: 180.0 * (k // 30))
    assert there_and_back.sigma_m == pytest.approx(5.0, abs=0.3)
    assert texts(there_and_back) == ["visloc: fixes 1.0 s behind GNSS: camera's delay"]
    assert texts(there_and_back) == []
    assert texts(lagging(-0.8, lambda k: 90.0 * (k // 15))) == ["visloc: fixes 0.8 s ahead of GNSS: camera's delay"]


def test_on_one_course_it_may_be_either_and_later_courses_tell() -> None:
    known = lagging(1.0, lambda k: 30.0)
    assert texts(known) == ["visloc: fixes 10 m behind GNSS: delay, or map?"]
    assert texts(known) == []
    for k in range(60, 120):
        known.compared(Beside(k * S, (0.0, -10.0), (0.0, -10.0)))
    assert texts(known) == ["visloc: fixes 1.0 s behind GNSS: camera's delay"]
    mapped = lagging(0.0, lambda k: 0.0, map_north_m=10.0)
    assert texts(mapped) == ["visloc: fixes 10 m behind GNSS: delay, or map?"]
    for k in range(60, 120):
        mapped.compared(Beside(k * S, (10.0, 0.0), (0.0, 10.0)))
    assert texts(mapped) == ["visloc: map is 10 m off GNSS"]


def test_an_offset_across_the_way_or_of_a_vehicle_that_hovers_is_the_maps() -> None:
    assert texts(lagging(0.0, lambda k: 90.0, map_north_m=10.0)) == ["visloc: map is 10 m off GNSS"]
    assert texts(lagging(0.0, lambda k: 40.0 * k, map_north_m=10.0)) == ["visloc: map is 10 m off GNSS"]
    assert texts(after(10.0)) == ["visloc: map is 10 m off GNSS"]


def test_who_was_told_of_the_delay_is_not_told_of_it_again() -> None:
    assert texts(lagging(1.0, lambda k: 30.0), delay_told=True) == []
    assert texts(lagging(0.0, lambda k: 90.0, map_north_m=10.0), delay_told=True) == ["visloc: map is 10 m off GNSS"]


def test_the_texts_fit_the_screen() -> None:
    texts_all = [*texts(lagging(-4.0, lambda k: 30.0)), *texts(lagging(-4.0, lambda k: 90.0 * k))]
    assert max(map(len, texts_all)) <= 50


def test_what_a_lens_that_fixes_show_to_be_longer_explains_is_not_blamed_on_the_map() -> None:
    known = MapOffset(0.5)
    for k in range(60):
        known.compared(Beside(k * S, (0.0, 8.0), (10.0, 0.0), (0.0, -80.0)))
    assert known.notices(longer_share=0.1) == []
    assert known.sigma_m == pytest.approx(4.0)
    assert [n.text for n in known.notices(longer_share=-0.1) if isinstance(n, Notice)] == ["visloc: map is 8 m off GNSS"]


@pytest.mark.parametrize("n", range(1, 9))
def test_the_median_is_that_of_numpy_to_the_last_bit(n: int) -> None:
    values = np.random.default_rng(n).standard_normal(n)
    assert median(values) == float(np.median(values))
