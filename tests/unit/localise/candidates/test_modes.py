from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.localise.candidates.modes import mass_near, mode_numbers, search_numbers, searched
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
    modes = searched(volume, np.ones(volume.score.shape, bool), grid_of((40, 50)), 0.05, DOWN).modes
    first, second = modes[:2]
    assert (first.north_m, first.east_m) == pytest.approx((100 - 2 * 23, -40 + 2 * 15))
    assert (second.north_m, second.east_m) == pytest.approx((100 - 2 * 7, -40 + 2 * 35))
    assert first.mass / second.mass == pytest.approx(np.exp(0.1 / 0.05), rel=0.05)
    assert mass_near(modes, np.array([54.0, -10.0]), 3.0) == pytest.approx(first.mass)
    assert mass_near(modes, np.array([0.0, 300.0]), 3.0) == 0.0


def test_modes_are_told_apart_by_the_ground_that_is_looked_at():
    volume = volume_of((10, 20, 1.0))
    volume.hypothesis[20, 10] = 1
    everywhere = np.ones(volume.score.shape, bool)
    (mode, *_) = searched(volume, everywhere, grid_of((40, 50)), 0.05, np.array([[0, 0], [30.0, 7.0]])).modes
    assert (mode.view_north_m - mode.north_m, mode.view_east_m - mode.east_m) == pytest.approx((30.0, 7.0))
    assert mass_near([mode], np.array([84.0, -3.0]), 3.0) == pytest.approx(mode.mass)
    assert mass_near([mode], np.array([54.0, -10.0]), 3.0) == 0.0


def test_first_modes_are_reported_about_the_prior():
    volume = volume_of((10, 20, 1.0), (30, 4, 0.9))
    numbers = mode_numbers(
        searched(volume, np.ones(volume.score.shape, bool), grid_of((40, 50)), 0.05, DOWN).modes, np.array([50.0, 0.0])
    )
    assert numbers["mode1_north_m"] == pytest.approx(4.0)
    assert numbers["mode1_east_m"] == pytest.approx(-10.0)
    assert numbers["modes"] >= 2
    assert 0 < numbers["mode2_probability"] < numbers["mode1_probability"] < 1


def test_no_scores_leave_no_modes():
    volume = ScoreVolume(np.full((4, 4), -1.0, np.float32), np.zeros((4, 4), np.int32), (0, 0))
    nothing = searched(volume, np.ones((4, 4), bool), grid_of((8, 8)), 0.05, DOWN)
    assert nothing.modes == []
    assert search_numbers(nothing, np.zeros(2)) == mode_numbers([], np.zeros(2)) == {"modes": 0.0}


def test_a_line_that_holds_the_place_across_alone_is_told_with_its_direction_and_spread():
    """A road along u (east): alike for 31 pixels of 2 m along it, one pixel across."""
    volume = volume_of()
    volume.score[12, 5:36] = 1.0
    told = searched(volume, np.ones(volume.score.shape, bool), grid_of((40, 50)), 0.02, DOWN)
    numbers = search_numbers(told, np.array([60.0, 10.0]))
    assert numbers["search_north_m"] == pytest.approx(100 - 2 * 15 - 60)
    assert numbers["search_east_m"] == pytest.approx(-40 + 2 * 25 - 10)
    assert numbers["search_sigma_east_m"] == pytest.approx(2 * 31 / np.sqrt(12), rel=1e-3)
    assert numbers["search_sigma_north_m"] == pytest.approx(2 / np.sqrt(12), rel=1e-3)
    assert numbers["search_entropy_nats"] == pytest.approx(np.log(31), rel=1e-3)
    assert abs(numbers["search_correlation"]) < 1e-6


def test_a_line_that_lies_askew_correlates_both_axes():
    volume = volume_of(*((k + 5, k, 1.0) for k in range(25)))  # to the south-east
    told = searched(volume, np.ones(volume.score.shape, bool), grid_of((40, 50)), 0.02, DOWN)
    assert search_numbers(told, np.zeros(2))["search_correlation"] == pytest.approx(-1, abs=0.01)


def test_a_search_that_leaves_everything_open_says_how_wide_though_no_place_stands_out():
    v, u = np.mgrid[0:230, 0:230]
    score = np.cos(2 * np.pi * u / 7) * np.cos(2 * np.pi * v / 7)  # some two thousand places alike
    volume = ScoreVolume(score.astype(np.float32) / 1000 + 0.5, np.zeros(score.shape, np.int32), (0, 0))
    told = searched(volume, np.ones(score.shape, bool), grid_of((230, 230)), 0.05, DOWN)
    numbers = search_numbers(told, np.zeros(2))
    assert numbers["modes"] == 0
    assert numbers["search_sigma_north_m"] == pytest.approx(2 * 230 / np.sqrt(12), rel=0.01)
    assert numbers["search_entropy_nats"] == pytest.approx(np.log(230**2), rel=0.01)
