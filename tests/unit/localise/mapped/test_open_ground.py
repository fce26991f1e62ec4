from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.localise import align
from visloc_companion.localise.mapped.open_ground import OpenGround, open_ground
from visloc_companion.localise.mapped.surface_error import height_covariance
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid

POSE = CameraPose(np.array([0.0, 0.0, -100.0]), R_FRD_CAM)
LEVEL = np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]) / 0.01**2


@pytest.fixture
def grid(support) -> MapGrid:
    """80 x 100 pixels of 1 m over level ground that is not known between samples 90 m apart."""
    picture = np.stack(
        [cv2.GaussianBlur(support.texture(k, 120)[:80, :100] / np.float32(255), (0, 0), 2) for k in (3, 4)], axis=-1
    )
    A = np.array([[0.0, -1.0, 39.5], [1.0, 0.0, -49.5]])
    rows, cols = np.mgrid[:80, :100]
    surface = (3 * np.sin(cols / 20) * np.cos(rows / 20)).astype(np.float32)
    return MapGrid(picture, np.ones((80, 100), np.float32), surface, A, 1.0, 90.0)


def stepped(grid: MapGrid, frame: MapGrid, ground: OpenGround | None) -> align.Step:
    sums = align.map_sums(align.prepare(grid), grid, POSE)
    return align.gauss_newton_step(sums, align.smoothed(frame.features), grid.weight, LEVEL, np.zeros(6), 1.0, ground)


def test_cells_share_the_window_and_raise_it(grid) -> None:
    ground = open_ground(grid)
    assert ground.shape == (9, 12)
    assert np.array_equal(np.unique(ground.cells), np.arange(9 * 12))
    assert (np.bincount(ground.cells.ravel()) <= ground.side_px**2).all()
    assert np.array_equal(ground.on(grid).surface_up_m, grid.surface_up_m)
    assert ground.raised(np.full(9 * 12, 2.5)).on(grid).surface_up_m == pytest.approx(grid.surface_up_m + 2.5)
    middle = np.array([[4.0, 4.0], [13.0, 4.0]])
    assert np.linalg.inv(ground.information)[:2, :2] == pytest.approx(height_covariance(grid, middle, 9.0), rel=1e-3, abs=1e-3)


def test_heights_that_are_known_change_nothing_and_open_ones_leave_less_known(grid, support) -> None:
    frame = replace(grid, features=np.roll(grid.features, 1, axis=1))
    without, ground = stepped(grid, frame, None), open_ground(grid)
    known = stepped(grid, frame, replace(ground, information=np.eye(len(ground.raised_m)) * 1e12))
    assert known.delta == pytest.approx(without.delta, rel=1e-4, abs=1e-6)
    assert known.information == pytest.approx(without.information, rel=1e-4)
    opened = stepped(grid, frame, ground)
    assert opened.score == without.score
    assert np.linalg.eigvalsh(without.information - opened.information).min() > -1e-6 * np.abs(without.information).max()
    assert opened.information[2, 2] < 0.5 * without.information[2, 2]


def test_a_hill_that_the_model_does_not_have_is_found_beside_the_pose(grid) -> None:
    """As a camera 100 m up sees ground that is 6 m higher to one side: what stands at a place shows beyond it."""
    v, u = np.indices(grid.weight.shape).astype(np.float32)
    hill = 6 * np.exp(-(((u - 80) / 15) ** 2) - ((v - 40) / 25) ** 2)
    nearer = hill / (100 - grid.surface_up_m)
    seen = cv2.remap(grid.features, u - (u - 49.5) * nearer, v - (v - 39.5) * nearer, cv2.INTER_LINEAR)
    frame, ground = replace(grid, features=seen), open_ground(grid)
    found = stepped(grid, frame, ground).ground
    assert found is not None
    raised = found.on(grid).surface_up_m - grid.surface_up_m
    assert raised[40, 80] > 3
    assert np.abs(raised[:, :45]).max() < 1
    assert np.corrcoef(raised.ravel(), hill.ravel())[0, 1] > 0.9
