"""Commands of two runs that differ in rounding, and in more than that."""

import pytest

from visloc_companion.app.rounding import largest_difference

FLOWN = ['5 {"type":"A","v":[1.5,-200.0],"n":3,"text":"x"}', '6 {"type":"B","p":{"lat":47.25},"none":null}']


def test_the_same_bytes_are_not_apart() -> None:
    assert largest_difference(FLOWN, list(FLOWN)) == 0.0


@pytest.mark.parametrize(
    ("line", "was", "now", "apart"),
    [
        (0, "-200.0", "-200.0000002", 1e-9),  # of its size
        (0, "1.5", "1.5000003", 2e-7),
        (1, "47.25", "47.250004725", 1e-7),
        (0, '"v":[1.5', '"v":[0.0', 1.0),
    ],
)
def test_numbers_are_apart_by_a_part_of_their_size(line: int, was: str, now: str, apart: float) -> None:
    other = list(FLOWN)
    other[line] = other[line].replace(was, now)
    assert other != FLOWN
    assert largest_difference(FLOWN, other) == pytest.approx(apart, rel=1e-3)


def test_numbers_below_one_are_apart_by_a_part_of_one() -> None:
    assert largest_difference(['1 {"v":1e-6}'], ['1 {"v":2e-6}']) == pytest.approx(1e-6)


@pytest.mark.parametrize(
    ("was", "now"),
    [
        ("5 {", "7 {"),
        ('"n":3', '"n":4'),
        ('"n":3', '"n":3.0'),
        ('"x"', '"y"'),
        ("[1.5,", "[1.5,1.5,"),
        ('"n"', '"m"'),
        ("-200.0", '{"float":"inf"}'),
    ],
)
def test_anything_but_a_number_is_more_than_rounding(was: str, now: str) -> None:
    other = [FLOWN[0].replace(was, now), FLOWN[1]]
    assert other != FLOWN
    assert largest_difference(FLOWN, other) is None


def test_the_rest_of_a_longer_run_is_left() -> None:
    assert largest_difference(FLOWN, FLOWN[:1]) == 0.0
