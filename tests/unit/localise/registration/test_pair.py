from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.localise.registration.base import NotRegistered, RegistrationPrior
from visloc_companion.localise.registration.clouds import density_per_m2, middle_m, within
from visloc_companion.localise.registration.height_map import upper_surface
from visloc_companion.localise.registration.pair import MOST_CELLS, MOST_PARTS, make_pair

RNG = np.random.default_rng(9)
PRIOR = RegistrationPrior(10.0, 3.0, 0.05, 0.01, 0.01)


def square(side_m: float, per_m2: float, middle: tuple[float, float] = (0, 0)) -> np.ndarray:
    xy = RNG.uniform(-side_m / 2, side_m / 2, (int(per_m2 * side_m**2), 2)) + middle
    return np.column_stack([xy, RNG.normal(0, 1, len(xy))])


@pytest.mark.parametrize(("per_m2", "cell_m"), [(12.0, 1.0), (4.0, 1.0), (2.2, 0.9), (0.28, 1.89)])
def test_the_cell_follows_the_references_density(per_m2, cell_m):
    pair = make_pair(square(60, 4), square(150, per_m2), PRIOR)
    assert pair.reference.cell_m == pair.source.cell_m == pytest.approx(cell_m, rel=0.05)


def test_only_what_the_prior_reaches_of_the_reference_is_looked_at():
    pair = make_pair(square(60, 2), square(600, 0.5), PRIOR)
    assert np.ptp(pair.reference_m[:, 0]) < 60 * 1.6 + 2 * 31
    assert max(pair.reference.known.shape) < MOST_CELLS


def test_a_reference_elsewhere_or_of_a_few_points_is_no_pair():
    away = make_pair(square(60, 2), square(100, 1, (500, 0)), PRIOR)
    few = make_pair(square(60, 2), square(100, 1)[:20], PRIOR)
    for none in (away, few):
        assert isinstance(none, NotRegistered)
        assert none.reason == Reason.OUTSIDE_MAP


def test_density_is_of_the_covered_ground_and_the_middle_of_the_box():
    two = np.vstack([square(40, 2), square(40, 2, (400, 0))])
    assert density_per_m2(two) == pytest.approx(2, rel=0.25)
    points = np.array([[0.0, 0, 0], [10, 20, 6], [9, 19, 6]])
    np.testing.assert_allclose(middle_m(points), [5, 10, 4])
    assert len(within(points, np.zeros(2), np.array([9.5, 20.0]))) == 2


def test_density_of_a_cloud_with_a_point_far_out_asks_for_no_array_of_all_that_lies_between():
    stray = np.vstack([square(40, 2), [[1e8, 1e8, 0.0]]])
    assert density_per_m2(stray) == pytest.approx(2, rel=0.25)


@pytest.mark.parametrize("source_side_m", [60.0, 20_000.0])
def test_no_surface_is_finer_than_memory_holds(monkeypatch, source_side_m):
    """A source of 20 km over a reference of 300 m had 1.6e9 parts of half a metre: 8 GB."""
    sides = []

    def seen(points_m, cell_m, parts):
        sides.append(float(np.ptp(points_m[:, :2], axis=0).max()) / (cell_m / parts))
        return upper_surface(points_m, cell_m, parts)

    monkeypatch.setattr("visloc_companion.localise.registration.pair.upper_surface", seen)
    per_m2 = 20_000 / source_side_m**2
    wide = RegistrationPrior(10_000.0, 3.0, 0.05, 0.01, 0.01)
    pair = make_pair(square(source_side_m, per_m2), np.vstack([square(300, 1), square(60, 20), [[9e3, 9e3, 0.0]]]), wide)
    assert max(sides) <= 1.02 * MOST_PARTS
    assert max(pair.reference.known.shape + pair.source.known.shape) <= MOST_CELLS + 2
