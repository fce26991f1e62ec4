from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.geo.camera import project
from visloc_companion.localise.working_size import reduced_model, resized
from visloc_companion.types import CameraModel

LARGE = CameraModel(1014, 761, 800.0, 810.0, 500.0, 390.0, (-0.1, 0.02, 0.0, 0.0, 0.0))


def test_a_reduced_model_sees_the_resized_frame() -> None:
    small = reduced_model(LARGE, 200_000)
    assert small.width_px * small.height_px == pytest.approx(200_000, rel=0.01)
    points = np.array([[0.0, 0.0, 1.0], [0.4, -0.3, 1.0]])
    share = np.array([small.width_px / 1014, small.height_px / 761])
    assert project(small, points) == pytest.approx((project(LARGE, points) + 0.5) * share - 0.5)
    assert resized(np.zeros((761, 1014, 3), np.uint8), small).shape == (small.height_px, small.width_px, 3)


def test_a_frame_that_is_hardly_too_large_stays() -> None:
    pixels = np.zeros((761, 1014), np.uint8)
    assert reduced_model(LARGE, 700_000) is LARGE
    assert resized(pixels, LARGE) is pixels
