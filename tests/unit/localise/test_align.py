"""The step from sums over blocks is the one from sums over pixels."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from visloc_companion.localise import align
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid
from visloc_companion.types import FloatArray

GSD_M = 0.5
LEVEL_NADIR = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def _grid(height: int, width: int, channels: int) -> MapGrid:
    rng = np.random.default_rng(3)
    features = cv2.GaussianBlur(rng.normal(0, 1, (height, width, channels)).astype(np.float32), (0, 0), 2.0)
    surface = cv2.GaussianBlur(rng.uniform(0, 20, (height, width)).astype(np.float32), (0, 0), 6.0)
    A = np.array([[0.0, -GSD_M, height * GSD_M / 2], [GSD_M, 0.0, -width * GSD_M / 2]])
    return MapGrid(features, np.ones((height, width), np.float32), surface, A, GSD_M)


def _by_pixels(
    descent: align.Descent, grid: MapGrid, pose: CameraPose, frame: FloatArray, weight: FloatArray, stride: int
) -> tuple[FloatArray, FloatArray]:
    """Normal equations of (delta, a change of gain), solved for delta; written out from the formula."""
    north, east = align.displacements(grid, pose)
    G = north[..., None] * descent.d_north + east[..., None] * descent.d_east
    A = np.concatenate([G, descent.template[None]]).astype(np.float64)[:, ::stride, ::stride]
    W, F = weight[::stride, ::stride, None].astype(np.float64), frame[::stride, ::stride].astype(np.float64)
    T = A[6]
    rho = float((W * F * T).sum() / (W * T * T).sum())
    M = np.einsum("ihwc,jhwc,hwx->ij", A, A, W)
    v = np.einsum("ihwc,hwc,hwx->i", A, F / rho - T, W)
    return np.linalg.inv(np.linalg.inv(M)[:6, :6]), np.asarray(np.linalg.solve(M, v)[:6])


@pytest.mark.parametrize(("size", "stride"), [((60, 75), 1), ((150, 171), 2)])
def test_a_step_from_blocks_is_the_step_from_pixels(size: tuple[int, int], stride: int) -> None:
    """With a mask that cuts blocks, weights in between, a surface, and sides that are no multiple of a block."""
    grid = _grid(*size, 3)
    pose = CameraPose(np.array([1.0, -2.0, -80.0]), LEVEL_NADIR)
    descent = align.prepare(grid)
    rng = np.random.default_rng(4)
    frame = np.roll(descent.template, 1, axis=1) * np.float32(0.4) + rng.normal(0, 0.01, grid.features.shape).astype(np.float32)
    weight = np.zeros(size, np.float32)
    weight[5:-7, 9:-3] = 1
    weight[20:30, 30:50] = 0.3
    frame *= weight[..., None] > 0
    step = align.gauss_newton_step(align.map_sums(descent, grid, pose), frame, weight, np.zeros((6, 6)), np.zeros(6), 1.0)
    H, delta = _by_pixels(descent, grid, pose, frame, weight, stride)
    apart = step.delta - delta
    assert apart @ H @ apart < 1e-4 * (delta @ H @ delta)
    assert step.information / step.information[0, 0] == pytest.approx(H / H[0, 0], rel=1e-3, abs=1e-2)
    assert step.n_pixels == pytest.approx(float(weight[::stride, ::stride].sum()), rel=1e-6)


def test_a_frame_that_shows_the_map_asks_for_no_correction() -> None:
    """Also where it is fainter: the gain is solved for."""
    grid = _grid(64, 64, 2)
    pose = CameraPose(np.array([0.0, 0.0, -60.0]), LEVEL_NADIR)
    descent = align.prepare(grid)
    sums = align.map_sums(descent, grid, pose)
    step = align.gauss_newton_step(sums, descent.template * np.float32(0.5), grid.weight, np.eye(6) * 1e-6, np.zeros(6), 1.0)
    assert step.score == pytest.approx(1.0, abs=1e-5)
    assert np.abs(step.delta).max() < 1e-4
