from __future__ import annotations

from visloc_companion.core.turns import REST, Turns
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
