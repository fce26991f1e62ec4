"""The sun over a real picture: lidar coloured from an aerial photograph."""

from __future__ import annotations

import laspy
import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from visloc_companion.localise.mapped.light import sun_over


@pytest.fixture(scope="module")
def park(shared_data):
    """Brightness and upper surface (H, W) of the coloured cloud, 1 m a pixel, north up; gaps filled from the nearest point."""
    cloud = laspy.read(shared_data / "clouds" / "autzen_park.laz")
    x, y, z = (np.asarray(axis) for axis in (cloud.x, cloud.y, cloud.z))
    colour = np.stack([cloud.red, cloud.green, cloud.blue], axis=1) @ np.array([0.299, 0.587, 0.114])
    col, row = np.floor(x - x.min()).astype(int), np.floor(y.max() - y).astype(int)
    up = np.full((row.max() + 1, col.max() + 1), -np.inf)
    np.maximum.at(up, (row, col), z)
    total, count = np.zeros_like(up), np.zeros_like(up)
    top = z >= up[row, col] - 1.0
    np.add.at(total, (row[top], col[top]), colour[top])
    np.add.at(count, (row[top], col[top]), 1)
    nearest = tuple(distance_transform_edt(count == 0, return_distances=False, return_indices=True))
    grey = total[nearest] / count[nearest]
    return np.asarray(grey * (255 / grey.max()), dtype=np.float32), np.asarray(up[nearest], dtype=np.float32)


@pytest.mark.parametrize(("part", "of"), [(0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (2, 3)])
def test_all_parts_of_a_photograph_are_lit_by_one_sun_in_the_east(park, part, of):
    grey, up = park
    across = slice(part * grey.shape[1] // of, (part + 1) * grey.shape[1] // of)
    sun = sun_over(grey[:, across], np.ones(grey[:, across].shape, np.bool_), up[:, across], 1.0)
    assert sun is not None
    assert sun.azimuth_deg == pytest.approx(98, abs=15)  # shadows of trees and of the bridge lie to the west
    assert 20 < sun.elevation_deg < 65
