"""What two pictures show is matched; what resembles by chance, as the noise of snow does, is left out."""

from __future__ import annotations

import cv2
import numpy as np

from visloc_companion.localise.structure.base import StereoSettings
from visloc_companion.localise.structure.disparity import Disparity, match
from visloc_companion.localise.structure.rectify import RectifiedPair
from visloc_companion.localise.structure.view import View
from visloc_companion.types import Image

SIZE = (240, 400)
SHIFT_PX, COUNT = 20, 48
NOISE_GREY = 5.0


def drawn(seed: int, scene: np.ndarray) -> Image:
    """The scene through a camera that smears over a pixel and resamples its own noise."""
    noisy = scene + np.random.default_rng(seed).normal(0, NOISE_GREY, scene.shape)
    return np.asarray(np.clip(cv2.GaussianBlur(noisy, (0, 0), 0.8), 0, 255), dtype=np.uint8)


def matched(contrast_grey: float) -> Disparity:
    """Level ground of so much contrast, SHIFT_PX apart in two pictures."""
    rows, columns = SIZE
    texture = np.random.default_rng(5).normal(0, 1, (rows, columns + SHIFT_PX))
    texture = cv2.GaussianBlur(texture, (0, 0), 1.5)
    scene = 200.0 + contrast_grey * texture / texture.std()
    left, right = drawn(1, scene[:, :columns]), drawn(2, scene[:, SHIFT_PX:])
    seen = np.ones(SIZE, np.bool_)
    view = View(np.diag([1.0, -1.0, -1.0]), 400.0, (0.0, 0.0), (columns, rows))
    return match(RectifiedPair(view, left, right, seen, seen, np.eye(4), 10.0, 10.0, COUNT), StereoSettings())


def right_of(found: Disparity) -> np.ndarray:
    return np.asarray(np.abs(found.value_px - SHIFT_PX)[found.good] < 1)


def test_ground_that_shows_something_is_matched_and_right() -> None:
    found = matched(20.0)
    assert found.good[:, COUNT:].mean() > 0.9
    assert right_of(found).mean() > 0.99


def test_noise_alone_is_hardly_matched() -> None:
    found = matched(0.0)
    assert found.good[:, COUNT:].mean() < 0.01


def test_of_what_is_as_faint_as_the_noise_most_is_right() -> None:
    found = matched(4.0)
    assert found.good[:, COUNT:].mean() > 0.5
    assert right_of(found).mean() > 0.8
