from __future__ import annotations

import numpy as np
import pytest

from tests.unit.localise.registration.conftest import cloud, terrain
from visloc_companion.localise.registration.height_search import HeightSearchRegistration
from visloc_companion.localise.registration.sampling import distinct, sampling_of

RNG = np.random.default_rng(12)
UTM_M = np.array([500_123.37, 5_512_345.61, 212.4])
SOUTH_M = UTM_M + np.array([0, 4_000_000, 0])


def scattered(per_m2: float = 4.0, side_m: float = 60.0) -> np.ndarray:
    return RNG.uniform(0, side_m, (int(per_m2 * side_m**2), 3))


def raster(step_m: float, side_m: float = 60.0) -> np.ndarray:
    x, y = np.meshgrid(np.arange(0, side_m, step_m), np.arange(0, side_m, step_m))
    return np.column_stack([x.ravel(), y.ravel(), RNG.normal(0, 3, x.size)])


@pytest.fixture(scope="module")
def dense_m() -> np.ndarray:
    """The scene's reference with so many points that cells are a metre."""
    return cloud(terrain(5), np.random.default_rng(13), np.zeros(2), 150, 8.0, 0.05)


def as_float32(points_m: np.ndarray, origin_m: np.ndarray) -> np.ndarray:
    return (points_m + origin_m).astype(np.float32).astype(np.float64) - origin_m


def error_and_level_m(scene, source_m: np.ndarray, reference_m: np.ndarray) -> tuple[float, float, float]:
    """Horizontal error of the source's mean point, the protection level, and the error in height."""
    found = HeightSearchRegistration(0.05)(source_m, reference_m, scene.prior)
    off = scene.offset_m(found.T_reference_source).mean(0)
    level = 4.80 * np.sqrt(np.linalg.eigvalsh(found.covariance_m2[:2, :2])[-1])
    return float(np.hypot(off[0], off[1])), float(level), float(off[2])


def test_a_raster_is_no_rounding_of_scattered_points():
    of_raster, of_rounded = sampling_of(raster(2.0)), sampling_of(np.rint(scattered() / 0.5) * 0.5)
    assert of_raster.raster and not of_rounded.raster
    assert of_raster.spacing_m == pytest.approx(2.0)
    assert not of_raster.unknown_m2.any()
    np.testing.assert_allclose(of_rounded.step_m, 0.5)
    np.testing.assert_allclose(of_rounded.unknown_m2, 0.25 / 12)


def test_scattered_points_and_fine_steps_are_as_they_are():
    for points in (scattered(), np.rint(scattered() * 10) / 10):
        found = sampling_of(points)
        assert not found.step_m.any() and not found.raster
        assert found.spread(points) is points


def test_a_copied_raster_is_a_raster_and_a_raster_beside_another_is_one_too():
    once = raster(1.0)
    assert sampling_of(np.repeat(once, 3, 0)).raster
    seam = np.vstack([once, once[once[:, 0] == 59] + [0, 0, 0.01]])[:-30]
    assert sampling_of(seam[: len(once) + 30]).raster


def test_heights_in_steps_are_uncertain_in_a_raster_as_well():
    points = raster(1.0)
    points[:, 2] = np.rint(points[:, 2])
    np.testing.assert_allclose(sampling_of(points).unknown_m2, [0, 0, 1 / 12])


@pytest.mark.parametrize(("origin_m", "step_m"), [(UTM_M, 0.5), (SOUTH_M, 1.0)])
def test_northings_in_float32_are_the_nearest_ones(origin_m, step_m):
    found = sampling_of(as_float32(scattered(), origin_m))
    assert found.step_m[1] == pytest.approx(step_m)
    assert not found.unknown_m2[:2].any()


def test_rounded_points_are_spread_over_their_step_again():
    points = np.rint(scattered(8.0))
    spread = sampling_of(points).spread(points)
    assert np.abs(spread - points)[:, :2].max() <= 0.5
    np.testing.assert_array_equal(spread[:, 2], points[:, 2])
    of_half = np.bincount(np.floor(2 * spread[:, 0]).astype(int) + 1)[2:-2]
    assert of_half.min() > 0.6 * of_half.mean()


def test_copies_are_counted_once():
    points = scattered()
    assert distinct(np.vstack([points, points[::-1]])) == distinct(np.repeat(points, 3, 0)) == len(points)


def test_a_reference_with_each_point_three_times_is_the_same_reference(scene):
    """A sparse reference got other cells, and heights 0.4 m off where forest has few points."""
    reference = scene.reference_m[::4]
    once = HeightSearchRegistration(1.0)(scene.source_m, reference, scene.prior)
    thrice = HeightSearchRegistration(1.0)(scene.source_m, np.tile(reference, (3, 1)), scene.prior)
    np.testing.assert_array_equal(thrice.T_reference_source, once.T_reference_source)
    np.testing.assert_array_equal(thrice.covariance_m2, once.covariance_m2)


@pytest.mark.parametrize("of_source", [True, False])
def test_points_in_whole_metres_are_placed_as_they_were(scene, dense_m, of_source):
    """The middle of their cells was 0.25 m aside on each axis."""
    clouds = [scene.source_m, dense_m]
    clouds[not of_source] = np.column_stack([np.rint(clouds[not of_source][:, :2]), clouds[not of_source][:, 2]])
    error, level, _ = error_and_level_m(scene, *clouds)
    assert error < 0.2 < level


def test_points_whose_metres_were_cut_off_are_within_their_level(scene, dense_m):
    """Nothing in them says that they were: 0.7 m off, level 0.5 m."""
    cut = np.column_stack([np.floor(scene.source_m[:, :2]), scene.source_m[:, 2]])
    error, level, _ = error_and_level_m(scene, cut, dense_m)
    assert 0.5 < error < 0.7 * level


def test_a_southern_cloud_in_float32_is_placed_as_it_was(scene, dense_m):
    """Its northings are in whole metres: 0.25 m to the side."""
    error, level, up = error_and_level_m(scene, scene.source_m, as_float32(dense_m, SOUTH_M))
    exact, level_of_exact, up_of_exact = error_and_level_m(scene, scene.source_m, dense_m)
    assert error < exact + 0.1
    assert level < 1.3 * level_of_exact
    assert abs(up - up_of_exact) < 0.1


def test_a_source_that_is_a_raster_lies_where_its_samples_do(scene, dense_m):
    """Samples a metre apart lay in one of the four parts of a cell: 0.35 m aside."""
    corner = np.floor(scene.source_m[:, :2].min(0))
    col, row = np.floor(scene.source_m[:, :2] - corner).astype(int).T
    top = np.full((row.max() + 1, col.max() + 1), -np.inf)
    np.maximum.at(top, (row, col), scene.source_m[:, 2])
    rows, cols = np.nonzero(np.isfinite(top))
    points = np.column_stack([corner[0] + cols + 0.5, corner[1] + rows + 0.5, top[rows, cols]])
    error, level, _ = error_and_level_m(scene, points, dense_m)
    assert error < 0.2 < level
