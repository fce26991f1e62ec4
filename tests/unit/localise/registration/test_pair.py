from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.localise.registration.base import NotRegistered, RegistrationPrior
from visloc_companion.localise.registration.clouds import density_per_m2, middle_m, within, without_strays
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


@pytest.mark.parametrize(("step_m", "cell_m"), [(0.25, 1.0), (0.5, 1.0), (1.0, 1.0), (1.5, 1.5), (2.0, 2.0)])
def test_a_cell_holds_whole_steps_of_a_raster(step_m, cell_m):
    """Cells of 1.02 m, beside a circle's edge: samples of 1 m lay half a metre to the east here and to the west there."""
    x, y = np.meshgrid(np.arange(-80, 80, step_m), np.arange(-80, 80, step_m))
    reference = np.column_stack([x.ravel(), y.ravel(), RNG.normal(0, 1, x.size)])
    pair = make_pair(square(60, 4), reference[np.hypot(x, y).ravel() < 75], PRIOR)
    assert pair.reference.cell_m == pytest.approx(cell_m, abs=1e-9)
    aside = np.mod(pair.reference.cells_of(reference[:, :2]) + 0.5, 1)
    np.testing.assert_allclose(aside.mean(0), 0.5, atol=1e-3)


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


def cliff(side_m: float, per_m2: float, drop_m: float, share: float) -> np.ndarray:
    """Two levels, one of so much of the points, with nothing between them."""
    points = square(side_m, per_m2)
    points[points[:, 0] > np.quantile(points[:, 0], 1 - share), 2] += drop_m
    return points


@pytest.mark.parametrize("axes", [(2,), (0, 1, 2)])
def test_values_for_no_data_are_left_out_whatever_their_sign_and_share(axes):
    points = square(60, 3)
    for share, rows in ((0.005, 7), (0.2, 3)):
        for value in (9999.0, -9999.0, -32768.0, 1e7):
            dirty = points.copy()
            dirty[:: round(1 / share) + rows, 2] = value
            kept = without_strays(dirty, axes)
            np.testing.assert_array_equal(kept, dirty[np.abs(dirty[:, 2]) < 99])
    both = points.copy()
    both[::150, 2], both[1::150, 2] = 9999, -9999
    assert len(without_strays(both, axes)) == len(points) - len(points[::150]) - len(points[1::150])


def test_points_of_another_place_are_left_out_of_a_source():
    dirty = square(60, 3, (4e5, 5e6))
    dirty[::300] = -9999.0
    assert len(without_strays(dirty, (0, 1, 2))) == len(dirty) - len(dirty[::300])
    strip = np.vstack([square(60, 3), square(60, 3, (400, 0))])
    assert without_strays(strip, (0, 1, 2)) is strip


@pytest.mark.parametrize(("drop_m", "share"), [(300.0, 0.03), (450.0, 0.5), (90.0, 0.001), (-200.0, 0.1)])
def test_a_cliff_stays(drop_m, share):
    ground = cliff(60, 3, drop_m, share)
    assert without_strays(ground, (0, 1, 2)) is ground


def test_a_wall_a_tower_with_sides_and_a_mountain_stay():
    wall = square(200, 2)
    wall[:, 2] += np.clip(wall[:, 0] * 20, -900, 900)  # 87 degrees
    tower = square(100, 3)
    on = np.hypot(*tower[:, :2].T) < 4
    tower[on, 2] += RNG.uniform(0, 300, on.sum())
    mountain = square(3000, 0.01)
    mountain[:, 2] += 2500 * np.exp(-((mountain[:, :2] / 400) ** 2).sum(1))
    for points in (wall, tower, mountain):
        assert without_strays(points, (0, 1, 2)) is points


def test_a_handful_of_points_far_above_goes_and_what_lies_between_as_well():
    points = square(60, 3)
    points[::400, 2] += 250
    points[1::400, 2] += 480
    assert len(without_strays(points, (2,))) == len(points) - len(points[::400]) - len(points[1::400])
    assert without_strays(points[:0], (0, 1, 2)).shape == (0, 3)
    assert without_strays(points[:1], (0, 1, 2)).shape == (1, 3)


def test_what_is_left_out_is_counted():
    source, reference = square(60, 3), square(150, 2)
    source[::200, 2], reference[::250, 2] = -9999, 9999
    pair = make_pair(source, reference, PRIOR)
    assert pair.strays[0] == len(source[::200])
    assert 0 < pair.strays[1] <= len(reference[::250])
    assert np.abs(pair.source_m[:, 2]).max() < 10 > np.abs(pair.reference_m[:, 2]).max()
    assert make_pair(square(60, 3), square(150, 2), PRIOR).strays == (0, 0)
    blank = square(60, 3)
    blank[:, 2] = np.where(RNG.random(len(blank)) < 0.5, 9999, -9999)
    assert not isinstance(make_pair(blank, reference, PRIOR), NotRegistered)
