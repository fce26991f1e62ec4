"""Hypotheses that waited long for a test, while nothing is known of the vehicle's velocity: each may be anywhere by then."""

from __future__ import annotations

import math

import pytest

from visloc_companion.core.places.place_search import PlaceSearch, Reach, Where
from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.types import Fix, GeoPoint, NoFix, OpenPlace, Vec2

S = 1_000_000_000
ORIGIN = GeoPoint(59.3, 18.1, 40.0)
HEIGHT_M, SIGMA_V_MPS = 120.0, 3.0
COV = ((1.0, 0.0), (0.0, 1.0))


def asked(search: PlaceSearch, k: int, t_s: float, sigma_v_mps: float = SIGMA_V_MPS) -> Where:
    search.moving(round(t_s * S), (0.0, 0.0))
    return search.next(k, round(t_s * S), HEIGHT_M, sigma_v_mps, Reach())


def answered(search: PlaceSearch, k: int, t_s: float, fix_at: Vec2 | None = None, open_at: Vec2 | None = None) -> bool:
    """Whether the answer finds the vehicle."""
    t_ns = round(t_s * S)
    answer: Fix | NoFix
    if fix_at is not None:
        place = wgs84.geo_from_ned((*fix_at, -HEIGHT_M), ORIGIN)
        answer = Fix(t_ns, t_ns, k, k, "test", place, (1.0, 0.0, 0.0, 0.0), COV, 1.0, 0.1, 0.0004, 1.0)
    else:
        places = () if open_at is None else (OpenPlace(wgs84.geo_from_ned((*open_at, -HEIGHT_M), ORIGIN), COV, math.log(0.9)),)
        answer = NoFix(t_ns, t_ns, k, k, "test", Reason.AMBIGUOUS, 1.0, open_places=places, footprint_m=120.0)
    return search.answered(answer, ORIGIN, t_ns) is not None


def is_tile(where: Where) -> bool:
    return where.within_m is not None


@pytest.mark.parametrize(("sigma_v_mps", "kept"), [(SIGMA_V_MPS, 0), (1.0, 1)])
def test_a_place_that_was_looked_for_in_vain_is_given_up_where_it_is_known_no_better_than_a_tile(
    sigma_v_mps: float, kept: int
) -> None:
    """12 m/s of unknown velocity: 38 m after 3 s, when it would be looked for again. A velocity that is vouched for keeps it."""
    search = PlaceSearch(2000.0)
    assert is_tile(asked(search, 1, 1.0, sigma_v_mps))
    answered(search, 1, 1.0, open_at=(300.0, 0.0))
    assert not is_tile(asked(search, 2, 2.0, sigma_v_mps))
    answered(search, 2, 2.0)
    assert len(search.places) == 1
    asked(search, 3, 4.0, sigma_v_mps)
    assert len(search.places) == kept


def test_one_that_was_never_looked_for_is_looked_for_all_the_same() -> None:
    search = PlaceSearch(2000.0)
    asked(search, 1, 1.0)
    answered(search, 1, 1.0, open_at=(300.0, 0.0))
    where = asked(search, 2, 17.0)
    assert not is_tile(where)
    assert math.sqrt(where.cov_ne_m2[0][0]) > 0.75 * HEIGHT_M


def test_a_fix_about_a_place_that_may_be_anywhere_tells_nothing_of_the_velocity() -> None:
    """A false place of 16 s before, 240 m from the vehicle: a fix there is of another place, and not of 15 m/s of velocity."""
    search, at = PlaceSearch(2000.0), (540.0, 0.0)
    asked(search, 1, 1.0)
    answered(search, 1, 1.0, open_at=(300.0, 0.0))
    asked(search, 2, 17.0)
    answered(search, 2, 17.0, fix_at=at)
    best = search.places[0]
    assert best.place_ne_m == pytest.approx(at, abs=0.01)
    assert best.velocity_error_mps == (0.0, 0.0)
    where = asked(search, 3, 17.5)
    assert not is_tile(where)
    assert where.place_ne_m == pytest.approx(at, abs=0.01)


def test_a_fix_where_the_motion_does_not_lead_is_a_place_of_its_own() -> None:
    """A place was seen twice, and a third fix lies 150 m from where it leads: one of them is right, and both are asked about."""
    search = PlaceSearch(2000.0)
    asked(search, 1, 1.0)
    answered(search, 1, 1.0, fix_at=(300.0, 0.0))
    for k, t_s, north_m in ((2, 2.0, 300.0), (3, 4.0, 340.0)):
        assert not is_tile(asked(search, k, t_s))
        answered(search, k, t_s, fix_at=(north_m, 0.0))
    assert not is_tile(asked(search, 4, 6.1))
    answered(search, 4, 6.1, fix_at=(300.0, 150.0))
    assert sorted(h.hits for h in search.places) == [0, 2]
    where = asked(search, 5, 6.2)
    assert where.place_ne_m == pytest.approx((300.0, 150.0), abs=0.01)


def test_a_vehicle_is_found_after_a_false_place_led_to_it() -> None:
    """North at 10 m/s past a false place that waited for 16 s; the autopilot tells no velocity."""
    search = PlaceSearch(2000.0)
    asked(search, 1, 1.0)
    answered(search, 1, 1.0, open_at=(400.0, 300.0))
    found_s = None
    for k in range(2, 200):
        t_s = 17.0 + 0.2 * (k - 2)
        where = asked(search, k, t_s)
        truth = (10.0 * t_s, 0.0)
        reach_m = where.within_m or 3 * math.sqrt(where.cov_ne_m2[0][0])
        seen = max(abs(a - b) for a, b in zip(truth, where.place_ne_m, strict=True)) <= reach_m
        if answered(search, k, t_s, fix_at=truth if seen and not is_tile(where) else None):
            found_s = t_s
            break
    assert found_s is not None
    assert found_s < 17.0 + 12.0
