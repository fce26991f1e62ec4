"""A line is one witness, however many blocks lie along it."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from visloc_companion.errors import Reason
from visloc_companion.localise.candidates.block_votes import REACH_PX, share_here, votes
from visloc_companion.localise.ortho_rectify import MapGrid
from visloc_companion.localise.verify import outvoted

TEMPERATURE = 1.04
SIDE = 120
Array = NDArray[np.float32]


def ground(seed: int) -> Array:
    """(SIDE, SIDE, 2) features of ground that no other seed has."""
    return cv2.GaussianBlur(np.random.default_rng(seed).normal(size=(SIDE, SIDE, 2)).astype(np.float32), (0, 0), 1.5) * 3


def shore(at_px: int, of_land: int, of_water: int) -> Array:
    """Land to the left of a bent shore, water to the right; the shore is by far the strongest."""
    features = ground(of_land)
    u, v = np.meshgrid(np.arange(SIDE), np.arange(SIDE))
    beyond = u - at_px - 4 * np.sin(v / 25)
    features[beyond > 0] = 0.5 * ground(of_water)[beyond > 0]
    features[np.abs(beyond) < 2.5] = (12.0, 0.0)
    return features


def asked(of_map: Array, frame: Array) -> NDArray[np.float64]:
    weight = np.zeros((SIDE, SIDE), np.float32)
    weight[12:-12, 12:-12] = 1
    grid = MapGrid(of_map, np.ones_like(weight), np.zeros_like(weight), np.eye(2, 3), 1.0)
    return votes(grid, frame, weight, TEMPERATURE)


def correlation(a: Array, b: Array) -> float:
    return float((a * b).sum() / math.sqrt((a * a).sum() * (b * b).sum()))


def test_a_shore_alone_is_no_place_though_it_is_most_of_the_score() -> None:
    """The land is another on the frame: ploughed anew, in leaf, under snow."""
    of_map, frame = shore(60, 1, 2), shore(60, 3, 4)
    assert correlation(of_map, frame) > 0.6
    assert share_here(asked(of_map, frame)) < 0.5


def test_half_a_frame_of_land_is_a_place_whatever_the_rest_shows() -> None:
    of_map = shore(60, 1, 2)
    assert share_here(asked(of_map, shore(60, 1, 4))) > 0.999
    assert share_here(asked(of_map, shore(54, 1, 4))) > 0.999  # the water has risen over some of it


def test_where_frame_and_shore_are_laid_on_each_other_the_land_says_that_it_lies_elsewhere() -> None:
    """The frame is held where its shore, which has moved by 8 pixels, lies on the map's."""
    land_moved = np.roll(shore(52, 1, 4), 8, axis=1)
    told = asked(shore(60, 1, 2), land_moved)
    assert share_here(told) < 0.01
    row, col = np.unravel_index(int(told.argmax()), told.shape)
    assert (col - REACH_PX, row - REACH_PX) == (-8, 0)


def test_blocks_that_show_nothing_of_the_map_give_no_place() -> None:
    told = asked(ground(1), ground(2))
    assert told.max() < 0.0
    assert share_here(told) < 0.1


def test_too_little_in_view_to_be_cut_into_blocks_says_nothing() -> None:
    grid = MapGrid(ground(1), np.ones((SIDE, SIDE), np.float32), np.zeros((SIDE, SIDE), np.float32), np.eye(2, 3), 1.0)
    weight = np.zeros((SIDE, SIDE), np.float32)
    weight[50:54, 50:54] = 1
    for seen in (weight, 0 * weight):
        assert not votes(grid, ground(1), seen, TEMPERATURE).any()


def test_what_the_blocks_leave_is_told() -> None:
    assert outvoted(0.04, 0.97, 0.05) is None
    why = outvoted(0.8, 0.2, 0.05)
    assert why is not None
    assert why == (Reason.BLOCKS_DISAGREE, "one structure or another place, 80 % by what single blocks show")


@pytest.mark.parametrize("nats", [0.0, -900.0])
def test_far_tails_are_no_error(nats: float) -> None:
    assert 0.0 <= share_here(np.full((2 * REACH_PX + 1,) * 2, nats)) < 0.1
