from __future__ import annotations

import math

import pytest

from visloc_companion.core.filter.votes import (
    ACROSS,
    CORRELATION,
    FLATTEST,
    GROUNDS,
    LEAST,
    LEAST_SPACING_M,
    RECENT_NS,
    SPACING,
    Votes,
    errs_again,
    moved,
    recent,
    spacing_m,
    view_ne_m,
    voted,
)
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.types import Fix, GeoPoint, Quat

S = 1_000_000_000
STEP_M = 24.0


def looked(*norths_m: float, method: str = "deep") -> Votes:
    votes: Votes = ()
    for k, north_m in enumerate(norths_m):
        votes = voted(votes, method, k * S, (north_m, 0.0), STEP_M)
    return votes


def test_over_the_same_ground_a_method_errs_again_however_often_it_looks() -> None:
    assert errs_again(looked(*[0.1 * k for k in range(50)]), "deep", (5.0, 0.0), STEP_M) == 1.0


def test_over_other_ground_by_half_for_each_step_on_but_land_repeats_itself() -> None:
    assert errs_again(looked(0.0), "deep", (STEP_M, 0.0), STEP_M) == pytest.approx(CORRELATION)
    assert errs_again(looked(0.0), "deep", (0.0, 2 * STEP_M), STEP_M) == pytest.approx(CORRELATION**2)
    assert errs_again(looked(0.0), "deep", (100 * STEP_M, 0.0), STEP_M) == LEAST


def test_many_short_ways_count_as_the_long_one() -> None:
    votes, together = looked(0.0), 1.0
    for k in range(1, 31):
        at = (k * STEP_M / 10, 0.0)
        together *= errs_again(votes, "deep", at, STEP_M)
        votes = voted(votes, "deep", k * S, at, STEP_M)
    assert together == pytest.approx(CORRELATION**3)


def test_who_sways_about_a_place_looks_at_the_same_ground() -> None:
    votes = looked(*[3.0 * (-1) ** k for k in range(200)])
    assert errs_again(votes, "deep", (0.0, 3.0), STEP_M) == 1.0


def test_ground_that_was_looked_at_a_while_ago_is_the_same_ground_still() -> None:
    to_and_fro = [2 * STEP_M * abs(2 - k % 4) for k in range(40)]
    assert errs_again(looked(*to_and_fro), "deep", (2 * STEP_M, 0.0), STEP_M) == 1.0
    assert errs_again(looked(*to_and_fro), "deep", (0.0, STEP_M), STEP_M) == CORRELATION
    further = looked(*[2 * STEP_M * k for k in range(GROUNDS + 1)])
    assert errs_again(further, "deep", (2 * STEP_M, 0.0), STEP_M) == 1.0
    assert errs_again(further, "deep", (0.0, 0.0), STEP_M) == CORRELATION**2


def test_what_is_other_ground_depends_on_what_the_camera_sees() -> None:
    assert spacing_m(200.0, 100.0) == SPACING * 200.0
    assert spacing_m(None, 100.0) == pytest.approx(SPACING * ACROSS * 100.0)
    assert spacing_m(20.0, 100.0) == spacing_m(None, -5.0) == LEAST_SPACING_M


@pytest.mark.parametrize(
    ("roll_deg", "pitch_deg", "yaw_deg", "north", "east"),
    [
        (0.0, 0.0, 0.0, 0.0, 0.0),
        (0.0, 45.0, 0.0, 1.0, 0.0),
        (0.0, 45.0, 90.0, 0.0, 1.0),
        (-30.0, 0.0, 0.0, 0.0, math.tan(math.radians(30.0))),
        (0.0, 89.0, 0.0, FLATTEST, 0.0),
        (0.0, 120.0, 180.0, -FLATTEST, 0.0),
    ],
)
def test_a_camera_that_leans_looks_at_ground_beside_it(
    roll_deg: float, pitch_deg: float, yaw_deg: float, north: float, east: float
) -> None:
    # the camera's body looks along its down axis: nose up is a look ahead
    q = quat_from_euler(math.radians(roll_deg), math.radians(pitch_deg), math.radians(yaw_deg))
    assert view_ne_m(turned(q), 50.0) == pytest.approx((50.0 * north, 50.0 * east), abs=1e-9)
    assert view_ne_m(turned(q), -1.0) == (0.0, 0.0)


def turned(q_ned_frd: Quat) -> Fix:
    return Fix(0, 0, 1, 1, "deep", GeoPoint(47.4, 8.5, 500.0), q_ned_frd, ((1.0, 0.0), (0.0, 1.0)), 2.0, 0.1, 0.01, 5.0)


def test_shapes_are_seen_over_more_than_a_frame() -> None:
    assert errs_again(looked(0.0, method="structure"), "structure", (100 * STEP_M, 0.0), STEP_M) == CORRELATION


def test_an_origin_that_moves_is_no_way() -> None:
    votes = moved(looked(0.0), (500.0, -200.0))
    assert errs_again(votes, "deep", (500.0, -200.0), STEP_M) == 1.0


def test_methods_are_told_apart_and_old_ones_are_no_votes_any_more() -> None:
    votes = voted(looked(0.0), "structure", RECENT_NS + 1, (1.0, 0.0), STEP_M)
    assert recent(votes, RECENT_NS + 1) == {"structure"}
    assert recent(votes, RECENT_NS) == {"deep", "structure"}
    assert errs_again(votes, "terrain", (0.0, 0.0), STEP_M) == 1.0
