"""What stands still in a camera's frames while the rest moves."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.unit.landing_gear import with_gear
from visloc_companion.doctor.collect.still import LEAST_FRAMES, StillEdges
from visloc_companion.types import Image

HEIGHT, WIDTH = 240, 320
ALL = np.ones((HEIGHT, WIDTH), np.bool_)


def flown_over(blobs: Image, k: int, noise: float = 4.0) -> Image:
    """Frame k of ground that moves aside by 3 px each way a frame."""
    part = blobs[3 * k : 3 * k + HEIGHT, 3 * k : 3 * k + WIDTH].astype(float)
    return np.clip(part + np.random.default_rng(k).normal(0, noise, part.shape), 0, 255).astype(np.uint8)


def with_text(frame: Image, k: int) -> Image:
    """A cross hair and two texts of a video link, of which one changes."""
    shown = frame.copy()
    for ink, thick in ((0, 4), (255, 2)):
        cv2.drawMarker(shown, (WIDTH // 2, HEIGHT // 2), ink, cv2.MARKER_CROSS, 40, thick)
        cv2.putText(shown, "ALT 118M", (190, 30), cv2.FONT_HERSHEY_SIMPLEX, 0.6, ink, thick)
        cv2.putText(shown, f"00:{k:02d}", (10, 230), cv2.FONT_HERSHEY_SIMPLEX, 0.6, ink, thick)
    return shown


def with_bars(frame: Image, _k: int) -> Image:
    shown = frame.copy()
    shown[:30] = shown[-30:] = 0
    return shown


def share(frames: list[Image], ground: NDArray[np.bool_] = ALL) -> float | None:
    edges = StillEdges(ground)
    for frame in frames:
        edges.add(frame)
    return edges.share


@pytest.fixture(scope="module")
def blobs() -> Image:
    rng, ground = np.random.default_rng(3), np.full((600, 600), 128.0)
    for sigma, contrast in ((3, 30), (12, 50)):
        part = cv2.GaussianBlur(rng.normal(0, 1, ground.shape), (0, 0), sigma)
        ground += contrast * part / part.std()
    return np.clip(ground, 0, 255).astype(np.uint8)


def test_ground_that_moves_leaves_nothing_that_stands(blobs) -> None:
    assert share([flown_over(blobs, k) for k in range(20)]) == pytest.approx(0.0, abs=0.001)


@pytest.mark.parametrize(("changed", "least"), [(with_text, 0.01), (with_bars, 0.01)])
def test_text_and_bars_over_moving_ground_stand(blobs, changed: Callable[[Image, int], Image], least: float) -> None:
    found = share([changed(flown_over(blobs, k), k) for k in range(20)])
    assert found is not None
    assert least < found < 0.1


def test_gear_over_half_of_the_picture_stands(blobs) -> None:
    found = share([with_gear(flown_over(blobs, k)) for k in range(20)])
    assert found is not None
    assert found > 0.1


def test_of_a_vehicle_at_rest_nothing_is_said(blobs) -> None:
    frame = flown_over(blobs, 0, noise=0.0)
    noisy = [np.clip(frame + np.random.default_rng(k).normal(0, 12, frame.shape), 0, 255).astype(np.uint8) for k in range(20)]
    assert share([with_text(frame, k) for k, frame in enumerate(noisy)]) is None
    for k, frame in enumerate(noisy):  # somebody walks by
        cv2.ellipse(frame, (40 + 8 * k, 120), (12, 40), 0, 0, 360, 20, -1)
    assert share(noisy) is None


def test_too_few_frames_and_frames_of_another_size_say_nothing(blobs) -> None:
    assert share([with_text(flown_over(blobs, k), k) for k in range(LEAST_FRAMES - 1)]) is None
    assert share([with_text(flown_over(blobs, k), k)[:, 1:] for k in range(20)]) is None


def test_what_is_masked_may_stand(blobs) -> None:
    marked = np.zeros((HEIGHT, WIDTH), np.uint8)
    marked[100:140, 130:190] = marked[5:40, 180:] = marked[205:, :90] = 1
    assert share([with_text(flown_over(blobs, k), k) for k in range(20)], marked == 0) == pytest.approx(0.0, abs=0.001)


def test_colour_of_a_larger_camera_is_reduced(blobs) -> None:
    frames = [cv2.resize(with_text(flown_over(blobs, k), k), (640, 480)) for k in range(12)]
    found = share([np.dstack([f] * 3) for f in frames], np.ones((480, 640), np.bool_))
    assert found is not None
    assert found > 0.01
