"""What agrees a few metres beside a place is uncertainty of it: along a dam, and between the trees of an orchard."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.localise.registration.base import NotRegistered, Registered, RegistrationPrior
from visloc_companion.localise.registration.correlation import Scores
from visloc_companion.localise.registration.height_search import HeightSearchRegistration
from visloc_companion.localise.registration.nearby import spread_m2
from visloc_companion.localise.registration.pair import make_pair
from visloc_companion.localise.registration.similarity import moved
from visloc_companion.localise.structure.claims import judged

PRIOR = RegistrationPrior(1.5, 3.0, np.radians(1.5), np.radians(1.0), 0.02, gaussian=True)
Heights = Callable[[np.ndarray], np.ndarray]


def dam(xy: np.ndarray) -> np.ndarray:
    return 4.0 * np.exp(-0.5 * (xy[:, 0] / 4.0) ** 2)


def orchard(xy: np.ndarray) -> np.ndarray:
    """A tree every 4 m."""
    off = (xy + 2.0) % 4.0 - 2.0
    return 3.0 * np.exp(-0.5 * (off**2).sum(1))


def clouds(heights: Heights, shift_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A source that belongs so far from where it lies, and the reference."""
    rng = np.random.default_rng(1)
    there, here = (rng.uniform(-half, half, (int(4 * 6 * half**2), 2)) for half in (50.0, 30.0))
    reference = np.column_stack([there, heights(there) + rng.normal(0, 0.1, len(there))])
    return np.column_stack([here - shift_m, heights(here) + rng.normal(0, 0.15, len(here))]), reference


@pytest.mark.parametrize("heights", [dam, orchard])
@pytest.mark.parametrize("shift_m", [(-2.0, 2.5), (2.2, -2.4)])
@pytest.mark.parametrize("by_score", [False, True])
def test_what_is_alike_within_the_prior_is_claimed_and_refused_in_flight(
    heights: Heights, shift_m: tuple[float, float], by_score: bool
) -> None:
    source, reference = clouds(heights, np.array(shift_m))
    found = HeightSearchRegistration(1.0, by_score=by_score)(source, reference, PRIOR)
    assert isinstance(found, Registered)
    middle = np.array([-shift_m[0], -shift_m[1], 0.0])
    off = moved(found.T_reference_source, middle)[:2]
    assert np.hypot(*off) > 1.0, "the place is chance, or the test says nothing"
    assert off @ np.linalg.solve(found.covariance_m2[:2, :2], off) < 13.8
    declined = judged(found, 0.05)
    assert isinstance(declined, NotRegistered)
    assert declined.reason is Reason.LOW_TEXTURE


@pytest.fixture
def pair(scene):
    return make_pair(scene.source_m, scene.reference_m, scene.prior)


def scores_about(pair, at_m: np.ndarray, *peaks: tuple[int, int, float]) -> Scores:
    """Scores of 0.2 about a cell but for some (columns east, rows north of it, score)."""
    u, v = np.rint(pair.reference.cells_of(at_m)).astype(int)
    score = np.full((41, 41), 0.2, np.float32)
    for east, north, value in peaks:
        score[20 + north, 20 + east] = value
    return Scores(score, np.zeros((41, 41), np.int32), (int(u) - 20, int(v) - 20))


def test_the_other_of_two_peaks_counts_by_its_score_and_one_that_is_another_place_does_not(pair, scene) -> None:
    cell = pair.reference.cell_m
    at = pair.reference.corner_m + cell * (np.rint(pair.reference.cells_of(pair.centre_m[:2])) + 0.5)

    def spread(*peaks: tuple[int, int, float]) -> np.ndarray:
        return spread_m2(pair, scores_about(pair, at, (0, 0, 0.7), *peaks), at, scene.prior)

    np.testing.assert_allclose(spread(), 0, atol=1e-9)
    np.testing.assert_allclose(spread((4, 0, 0.7)), np.diag([(4 * cell) ** 2 / 2, 0]), atol=1e-6)
    assert 0 < spread((4, 0, 0.69))[0, 0] < spread((4, 0, 0.7))[0, 0] / 5
    np.testing.assert_allclose(spread((9, 0, 0.7)), 0, atol=1e-9)


def test_the_prior_is_no_part_of_it(pair, scene) -> None:
    """A Gaussian prior's handicap was taken from the scores: a flat score stays as wide as it is."""
    at = pair.centre_m[:2]
    prior = replace(scene.prior, sigma_horizontal_m=1.0, gaussian=True)
    flat = scores_about(pair, at)
    first = np.array(flat.origin) - pair.reference.cells_of(at)
    east, north = (pair.reference.cell_m * (k + np.arange(41)) for k in first)
    handicapped = replace(flat, score=flat.score - 0.5 / 60 * (east**2 + north[:, None] ** 2).astype(np.float32))
    np.testing.assert_allclose(spread_m2(pair, handicapped, at, prior), spread_m2(pair, flat, at, scene.prior), rtol=1e-3)


def test_where_nothing_was_searched_nothing_is_added(pair, scene) -> None:
    none = Scores(np.zeros((0, 0), np.float32), np.zeros((0, 0), np.int32), (0, 0))
    np.testing.assert_array_equal(spread_m2(pair, none, pair.centre_m[:2], scene.prior), 0)
