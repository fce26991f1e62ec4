from __future__ import annotations

import numpy as np
import pytest

from benchmarks.flown.same_ground import Match, lasts_m, stays
from visloc_companion.core.filter.votes import CORRELATION

CLAIM = 0.3


def answers(method: str, way_m: float, n: int) -> list[float]:
    """What it is wrong by, 0 where it is right."""
    rng, match = np.random.default_rng(1), Match(method)
    found = (match.look(way_m, lasts_m(100.0), CLAIM, rng, lambda: rng.uniform(1.0, 9.0, 1)) for _ in range(n))
    return [0.0 if each is None else float(each[0]) for each in found]


def test_who_stays_has_the_same_answer() -> None:
    assert len(set(answers("deep", 0.0, 500))) == 1


def test_who_flies_on_is_wrong_as_often_as_is_claimed_and_half_as_long_for_each_way() -> None:
    found = answers("deep", lasts_m(100.0) / 2, 40_000)
    wrong = [each > 0 for each in found]
    assert np.mean(wrong) == pytest.approx(CLAIM, abs=0.01)
    again = [b == a for a, b in zip(found[:-2], found[2:], strict=True) if a > 0]
    assert np.mean(again) == pytest.approx(0.5, abs=0.02)


def test_shapes_are_of_more_than_a_frame() -> None:
    assert stays("structure", 1e6, 24.0) == CORRELATION
    assert stays("deep", 1e6, 24.0) == 0.0
