from __future__ import annotations

from visloc_companion.core.turns import MOST_LOST, REST, Turns
from visloc_companion.types import Vote


def votes(turns: Turns, found: dict[Vote, bool], n: int) -> list[Vote]:
    asked = []
    for _ in range(n):
        asked.append(turns.vote)
        turns.answered(found[turns.vote])
    return asked


def test_the_image_alone_where_structure_is_off() -> None:
    assert set(votes(Turns(False, 3), {Vote.IMAGE: False, Vote.STRUCTURE: True}, 20)) == {Vote.IMAGE}
    assert set(votes(Turns(False, 3), {Vote.IMAGE: True, Vote.STRUCTURE: True}, 20)) == {Vote.IMAGE}


def test_structure_after_an_image_that_was_not_recognised() -> None:
    asked = votes(Turns(True, 0), {Vote.IMAGE: False, Vote.STRUCTURE: True}, 6)
    assert asked == [Vote.IMAGE, Vote.STRUCTURE] * 3


def test_structure_in_turn_with_image_fixes() -> None:
    asked = votes(Turns(True, 3), {Vote.IMAGE: True, Vote.STRUCTURE: True}, 8)
    assert asked == [Vote.IMAGE, Vote.IMAGE, Vote.IMAGE, Vote.STRUCTURE] * 2


def test_image_fixes_alone_ask_for_no_structure_unless_it_has_its_turn() -> None:
    assert set(votes(Turns(True, 0), {Vote.IMAGE: True, Vote.STRUCTURE: True}, 50)) == {Vote.IMAGE}


def test_a_structure_that_fails_rests() -> None:
    asked = votes(Turns(True, 0), {Vote.IMAGE: False, Vote.STRUCTURE: False}, 2 + 2 * (REST + 1))
    assert asked == [Vote.IMAGE, Vote.STRUCTURE, *([Vote.IMAGE] * REST + [Vote.STRUCTURE]) * 2]


def test_a_structure_that_costs_the_worker_its_life_is_not_asked_again_and_again() -> None:
    """A small computer may miss the deadline with it: after the second time the image is left alone."""
    turns = Turns(True, 0)
    asked = []
    for _ in range(4 * (REST + 1)):
        asked.append(turns.vote)
        turns.answered(False, lost=turns.vote is Vote.STRUCTURE)
    assert asked.count(Vote.STRUCTURE) == MOST_LOST
    assert set(asked[-REST:]) == {Vote.IMAGE}


def test_a_lost_image_vote_takes_nothing_away_from_structure() -> None:
    turns = Turns(True, 0)
    for _ in range(5):
        turns.answered(False, lost=turns.vote is Vote.IMAGE)
        turns.answered(True)
    turns.answered(False)
    assert turns.vote is Vote.STRUCTURE
