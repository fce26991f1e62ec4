from __future__ import annotations

import pytest

from visloc_companion.core.votes import CORRELATION, LEAST, RECENT_NS, SPACING, Votes, errs_again, moved, recent, voted

S = 1_000_000_000
APART_M = 60.0
STEP_M = SPACING * APART_M


def looked(*norths_m: float, method: str = "deep") -> Votes:
    votes: Votes = ()
    for k, north_m in enumerate(norths_m):
        votes = voted(votes, method, k * S, (north_m, 0.0), APART_M)
    return votes


def test_over_the_same_ground_a_method_errs_again_however_often_it_looks() -> None:
    assert errs_again(looked(*[0.1 * k for k in range(50)]), "deep", (5.0, 0.0), APART_M) == 1.0


def test_over_other_ground_by_half_for_each_step_on_but_land_repeats_itself() -> None:
    assert errs_again(looked(0.0), "deep", (STEP_M, 0.0), APART_M) == pytest.approx(CORRELATION)
    assert errs_again(looked(0.0), "deep", (0.0, 2 * STEP_M), APART_M) == pytest.approx(CORRELATION**2)
    assert errs_again(looked(0.0), "deep", (100 * STEP_M, 0.0), APART_M) == LEAST


def test_many_short_ways_count_as_the_long_one() -> None:
    votes, together = looked(0.0), 1.0
    for k in range(1, 31):
        at = (k * STEP_M / 10, 0.0)
        together *= errs_again(votes, "deep", at, APART_M)
        votes = voted(votes, "deep", k * S, at, APART_M)
    assert together == pytest.approx(CORRELATION**3)


def test_who_sways_about_a_place_looks_at_the_same_ground() -> None:
    votes = looked(*[3.0 * (-1) ** k for k in range(200)])
    assert errs_again(votes, "deep", (0.0, 3.0), APART_M) == 1.0


def test_shapes_are_seen_over_more_than_a_frame() -> None:
    assert errs_again(looked(0.0, method="structure"), "structure", (100 * STEP_M, 0.0), APART_M) == CORRELATION


def test_an_origin_that_moves_is_no_way() -> None:
    votes = moved(looked(0.0), (500.0, -200.0))
    assert errs_again(votes, "deep", (500.0, -200.0), APART_M) == 1.0


def test_methods_are_told_apart_and_old_ones_are_no_votes_any_more() -> None:
    votes = voted(looked(0.0), "structure", RECENT_NS + 1, (1.0, 0.0), APART_M)
    assert recent(votes, RECENT_NS + 1) == {"structure"}
    assert recent(votes, RECENT_NS) == {"deep", "structure"}
    assert errs_again(votes, "terrain", (0.0, 0.0), APART_M) == 1.0
