"""Of a region that is far larger than the map, no more is read than the map has."""

from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.geo.wgs84 import distance_m, geo_from_ned
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.local_frame import local_frame
from visloc_companion.localise.mapped.map_part import part_on_map, reaches_all, worth_reading
from visloc_companion.localise.mapped.window import MAX_SIDE_PX, cropped, map_grid, searched_map
from visloc_companion.localise.registry import make_localiser
from visloc_companion.types import CameraModel, Fix, ReferencePatch

MODEL = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)
LEVEL = (0.0, 0.0, 0.6)


class Asked:
    """A map of 500 x 500 m about home that says where it ends, and the sizes of the windows that were asked of it."""

    def __init__(self, ref, says_its_corners: bool = True) -> None:
        self._ref, self.sizes_px = ref, []
        if says_its_corners:
            rows, cols = ref.pixels.shape[:2]
            sides = np.array([[-1, 1], [1, 1], [-1, -1], [1, -1]]) / 2
            self.corners_map_m = sides * np.array([cols, rows])

    def __getattr__(self, name: str):
        return getattr(self._ref, name)

    def patch(self, center_map_m, size_px, gsd_m, heading_rad) -> ReferencePatch:
        self.sizes_px.append(max(size_px))
        return self._ref.patch(center_map_m, size_px, gsd_m, heading_rad)


@pytest.mark.parametrize("method", ["gradient", "ncc", "keypoint"])
def test_a_prior_that_reaches_far_beyond_the_map_reads_the_map_alone(flat, support, method):
    """It reaches 1.2 km to every side."""
    truth = 60.0, -40.0, -235.0
    ref, frame = Asked(flat), support.render(flat, MODEL, truth, LEVEL)
    answer = make_localiser(method, MODEL).localise(support.request_at((0.0, 0.0, -235.0), LEVEL, sigma_m=400.0), frame, ref)
    assert isinstance(answer, Fix)
    assert distance_m(answer.place, geo_from_ned(truth, support.HOME)) < 3.0
    assert 300 < max(ref.sizes_px) < 700


def test_the_window_of_a_search_is_what_it_was_but_for_what_lies_beyond_the_map(flat, support):
    frame = local_frame(support.HOME, flat)
    low, high = np.array([-1500.0, -900.0]), np.array([1100.0, 1300.0])
    whole = cropped(map_grid(Asked(flat, says_its_corners=False), frame, low, high, 1.0, GRADIENT))
    part = searched_map(Asked(flat), frame, low, high, 1.0, GRADIENT)
    assert part.features.shape == whole.features.shape
    np.testing.assert_allclose(part.A_ne_pix, whole.A_ne_pix, atol=1.0)
    assert part.weight.sum() == pytest.approx(whole.weight.sum(), rel=0.01)


def test_boxes_that_the_map_fills_or_says_nothing_of_are_read_as_they_are(flat, support):
    frame = local_frame(support.HOME, flat)
    low, high = np.array([-240.0, -300.0]), np.array([200.0, 100.0])
    for ref in (Asked(flat), Asked(flat, says_its_corners=False)):
        box = worth_reading(ref, frame, low, high, 4000.0, 64.0)
        np.testing.assert_array_equal(box, (low, high))
    beyond = low + 5000.0, high + 5000.0
    assert part_on_map(Asked(flat), frame, *beyond) is None
    np.testing.assert_array_equal(worth_reading(Asked(flat), frame, *beyond, 4000.0, 64.0), beyond)


def test_of_more_than_a_window_holds_the_part_nearest_to_the_middle_is_read(flat, support):
    """The map lies 1.4 km south of the box's middle, north of which there is nothing."""
    frame = local_frame(support.HOME, flat)
    low, high = np.array([-600.0, -2000.0]), np.array([3400.0, 2000.0])
    first, last = worth_reading(Asked(flat), frame, low, high, 300.0, 0.0)
    np.testing.assert_allclose(last - first, 300.0)
    assert last[0] == pytest.approx(250.0, abs=6.0)
    assert (first[1] + last[1]) / 2 == pytest.approx(0.0, abs=1.0)
    assert not reaches_all(Asked(flat), frame, low, high, 300.0)
    assert reaches_all(Asked(flat), frame, low, high, float(MAX_SIDE_PX))
    assert not reaches_all(Asked(flat, says_its_corners=False), frame, low, high, 300.0)
