from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.localise.registration.height_map import HeightMap, high_passed, smoothed, upper_surface


def grid_points(heights: np.ndarray, step: float = 1.0) -> np.ndarray:
    rows, cols = np.indices(heights.shape)
    return np.column_stack([(cols.ravel() + 0.5) * step, (rows.ravel() + 0.5) * step, heights.ravel()])


def test_a_cell_is_the_mean_of_the_highest_points_of_its_parts():
    corners = [[0.0, 0.0, 0.0], [5.9, 5.9, 0.0]]
    cell = [[2.1, 2.1, 1], [2.2, 2.2, 3], [2.6, 2.1, 5]]  # two parts of 0.5 m: highest 3 and 5
    surface = upper_surface(np.array(corners + cell), 1.0, 2)
    assert surface.known[2, 2]
    assert surface.height_m[2, 2] == 4
    assert not surface.known[3, 3]


def test_rows_run_north_and_columns_east():
    heights = np.arange(30.0).reshape(5, 6)
    surface = upper_surface(grid_points(heights), 1.0, 1)
    np.testing.assert_array_equal(surface.corner_m, [0.0, 0.0])
    column, row = np.round(surface.cells_of(np.array([[3.5, 1.5]]))[0]).astype(int)
    assert (column, row) == (3, 1)
    assert surface.height_m[row, column] == heights[1, 3]


def test_a_spike_among_known_neighbours_is_left_out():
    heights = np.zeros((9, 9))
    heights[4, 4] = 8.0
    surface = upper_surface(grid_points(heights), 1.0, 1)
    assert surface.known.sum() == 80
    assert surface.height_m.max() == 0


def test_smoothing_fills_a_gap_of_one_cell_with_its_neighbours():
    known = np.ones((15, 15), bool)
    known[7, 7] = False
    surface = HeightMap(np.where(known, 3.0, 0).astype(np.float32), known, np.zeros(2), 1.0)
    filled = smoothed(surface, 1.0)
    assert filled.known[7, 7]
    np.testing.assert_allclose(filled.height_m[filled.known], 3.0, rtol=1e-5)


def test_relief_is_free_of_slopes_and_keeps_what_is_small():
    rows, cols = np.indices((60, 60)).astype(float)
    slope = 0.2 * cols - 0.1 * rows + 300
    bump = slope + 4.0 * (np.hypot(rows - 30, cols - 30) < 2)
    known = np.ones((60, 60), bool)
    of_slope, of_bump = (high_passed(HeightMap(z.astype(np.float32), known, np.zeros(2), 1.0)) for z in (slope, bump))
    assert np.abs(of_slope.height_m).max() < 0.01
    assert of_bump.height_m[30, 30] > 3.5


def test_around_is_a_part_at_its_place():
    surface = HeightMap(np.arange(100, dtype=np.float32).reshape(10, 10), np.ones((10, 10), bool), np.array([100.0, 50.0]), 2.0)
    part = surface.around(np.array([110.0, 60.0]), 4.0)
    np.testing.assert_array_equal(part.corner_m, [106.0, 56.0])
    assert part.height_m[0, 0] == surface.height_m[3, 3]
    assert surface.around(np.array([500.0, 60.0]), 4.0).known.size == 0


@pytest.mark.parametrize("spacing_m", [0.125, 0.25, 0.5])
def test_a_surface_of_a_raster_lies_where_its_samples_do(spacing_m):
    """Cells that began at the first sample put a plane half a sample's spacing to the east and north."""
    x, y = np.meshgrid(np.arange(0, 20, spacing_m), np.arange(0, 30, spacing_m))
    points = np.column_stack([x.ravel() + 1000, y.ravel() - 7, (0.5 * x + 0.25 * y).ravel()])
    surface = upper_surface(points, 1.0, 2)
    east, north = (surface.corner_m + 1.0 * np.array([10.5, 15.5])) - [1000, -7]
    highest = (0.5 + 0.25) * (0.25 - spacing_m / 2)  # of a part over its middle
    assert surface.height_m[15, 10] == pytest.approx(0.5 * east + 0.25 * north + highest, abs=1e-4)
