"""Parts of a frame that pull its pose to and fro widen what is claimed; noise does not."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from visloc_companion.localise import align
from visloc_companion.localise.candidates.clustered import excess_variance
from visloc_companion.localise.candidates.descent import CORRELATED_PX
from visloc_companion.localise.candidates.frame_features import Seen
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid
from visloc_companion.localise.pose import PriorTerm

GSD_M, SIDE = 0.5, 130
DOWN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
POSE = CameraPose(np.array([0.0, 0.0, -60.0]), DOWN)
PRIOR = PriorTerm(DOWN, 0.01)
Array = NDArray[np.float32]


@dataclass
class Still:
    """Frame features that are what they are, whatever the pose."""

    values: Array

    def on_surface(self, pose: CameraPose, grid: MapGrid) -> Seen:
        return self.values, np.ones(self.values.shape[:2], np.float32)


def texture(seed: int, sigma_px: float = 2.0) -> Array:
    values = np.random.default_rng(seed).normal(size=(SIDE, SIDE, 2)).astype(np.float32)
    return cv2.GaussianBlur(values, (0, 0), sigma_px) * np.float32(sigma_px * 3)


def sigmas(of_map: Array, frame: Array) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Formal and widened 1-sigmas of the six unknowns, and the excess."""
    A_ne_pix = np.array([[0.0, -GSD_M, SIDE * GSD_M / 2], [GSD_M, 0.0, -SIDE * GSD_M / 2]])
    grid = MapGrid(of_map, np.ones((SIDE, SIDE), np.float32), np.zeros((SIDE, SIDE), np.float32), A_ne_pix, GSD_M)
    descent = align.prepare(grid)
    excess = excess_variance(Still(frame), POSE, grid, descent, PRIOR)
    information, pull = PRIOR.at(POSE)
    sums, seen = align.map_sums(descent, grid, POSE), align.smoothed(frame)
    step = align.gauss_newton_step(sums, seen, np.ones((SIDE, SIDE), np.float32), information, pull, CORRELATED_PX)
    formal = np.linalg.inv(step.information + information)
    return np.sqrt(np.diag(formal)), np.sqrt(np.diag(formal + formal @ excess @ formal)), excess


@pytest.mark.parametrize("seed", range(4))
def test_noise_that_is_as_the_information_takes_it_widens_nothing(seed: int) -> None:
    of_map = texture(seed)
    formal, widened, _ = sigmas(of_map, of_map + texture(seed + 50) * np.float32(0.5))
    assert (widened >= formal).all()
    assert (widened < 1.35 * formal).all()


@pytest.mark.parametrize(("axis", "towards"), [(1, 1), (0, 0)], ids=["east", "south"])
def test_a_half_that_has_moved_widens_along_its_way(axis: int, towards: int) -> None:
    """By two pixels, half a pixel each way from where the descent ends."""
    of_map = texture(1)
    frame = np.roll(of_map, -1, axis=axis)
    half = np.roll(of_map, 1, axis=axis)
    frame[:, SIDE // 2 :] = half[:, SIDE // 2 :]
    formal, widened, excess = sigmas(of_map, frame)
    assert widened[towards] > 1.8 * formal[towards]
    assert np.linalg.eigvalsh(excess).min() >= -1e-6 * np.linalg.eigvalsh(excess).max()


def test_a_frame_that_is_the_map_widens_nothing() -> None:
    of_map = texture(1)
    formal, widened, _ = sigmas(of_map, of_map)
    np.testing.assert_allclose(widened, formal)
