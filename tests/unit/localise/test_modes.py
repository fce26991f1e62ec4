from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.localise.modes import mass_near, mode_numbers, place_modes
from visloc_companion.localise.ortho_rectify import MapGrid
from visloc_companion.localise.search import ScoreVolume

A_NE_PIX = np.array([[0.0, -2.0, 100.0], [2.0, 0.0, -40.0]])  # 2 m a pixel, u to the east, v to the south
DOWN = np.zeros((1, 2))


def volume_of(*peaks: tuple[int, int, float]) -> ScoreVolume:
    score = np.zeros((30, 40), np.float32)
    for u, v, height in peaks:
        score[v, u] = height
    return ScoreVolume(score, np.zeros(score.shape, np.int32), (5, 3))


def grid_of(shape: tuple[int, int]) -> MapGrid:
    plain = np.zeros(shape, np.float32)
    return MapGrid(np.zeros((*shape, 2), np.float32), plain + 1, plain, A_NE_PIX, 2.0)


def test_modes_lie_where_the_scores_are_in_metres():
    volume = volume_of((10, 20, 1.0), (30, 4, 0.9))
    modes = place_modes(volume, np.ones(volume.score.shape, bool), grid_of((40, 50)), 0.05, DOWN)
    first, second = modes[:2]
    assert (first.north_m, first.east_m) == pytest.approx((100 - 2 * 23, -40 + 2 * 15))
    assert (second.north_m, second.east_m) == pytest.approx((100 - 2 * 7, -40 + 2 * 35))
    assert first.mass / second.mass == pytest.approx(np.exp(0.1 / 0.05), rel=0.05)
    assert mass_near(modes, np.array([54.0, -10.0]), 3.0) == pytest.approx(first.mass)
    assert mass_near(modes, np.array([0.0, 300.0]), 3.0) == 0.0


def test_modes_are_told_apart_by_the_ground_that_is_looked_at():
    volume = volume_of((10, 20, 1.0))
    volume.hypothesis[20, 10] = 1
    (mode, *_) = place_modes(volume, np.ones(volume.score.shape, bool), grid_of((40, 50)), 0.05, np.array([[0, 0], [30.0, 7.0]]))
    assert (mode.view_north_m - mode.north_m, mode.view_east_m - mode.east_m) == pytest.approx((30.0, 7.0))
    assert mass_near([mode], np.array([84.0, -3.0]), 3.0) == pytest.approx(mode.mass)
    assert mass_near([mode], np.array([54.0, -10.0]), 3.0) == 0.0


def test_first_modes_are_reported_about_the_prior():
    volume = volume_of((10, 20, 1.0), (30, 4, 0.9))
    numbers = mode_numbers(
        place_modes(volume, np.ones(volume.score.shape, bool), grid_of((40, 50)), 0.05, DOWN), np.array([50.0, 0.0])
    )
    assert numbers["mode1_north_m"] == pytest.approx(4.0)
    assert numbers["mode1_east_m"] == pytest.approx(-10.0)
    assert numbers["modes"] >= 2
    assert 0 < numbers["mode2_probability"] < numbers["mode1_probability"] < 1


def test_no_scores_leave_no_modes():
    volume = ScoreVolume(np.full((4, 4), -1.0, np.float32), np.zeros((4, 4), np.int32), (0, 0))
    assert place_modes(volume, np.ones((4, 4), bool), grid_of((8, 8)), 0.05, DOWN) == []
    assert mode_numbers([], np.zeros(2)) == {"modes": 0.0}
