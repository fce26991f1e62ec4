"""Crowns alike nearby are told from the ground between them."""

from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.localise.terrain import noise, standing
from visloc_companion.localise.terrain.cells import MOST_WIDE_CELLS, Cells, cells_of
from visloc_companion.localise.terrain.noise import RANGE_M, HeightNoise, Stated
from visloc_companion.localise.terrain.standing import Standing, at_first, refitted, told_apart

EXPECTED = HeightNoise(1.5)
BOUNDS_M = (0.75, 3.75)
ROUNDS = 15


def line_of_stands(seed: int) -> tuple[Cells, np.ndarray, np.ndarray]:
    """300 soundings 10 m apart: stands of 250 m, every other of them with crowns of 3 to 5 m; one in five lets through."""
    rng = np.random.default_rng(seed)
    at = np.column_stack([np.arange(300) * 10.0, np.zeros(300)])
    crown = np.where((np.arange(300) // 25 % 2 == 1) & (rng.random(300) < 0.8), rng.uniform(3, 5, 300), 0.0)
    return cells_of(at), rng.normal(0, 1.2, 300) + crown, crown > 0


def fitted(cells: Cells, difference: np.ndarray) -> Standing:
    found = at_first(EXPECTED, cells)
    for _ in range(ROUNDS):
        found = refitted(found, cells, difference, np.ones(len(difference), bool), BOUNDS_M, Stated(1.5, 60.0))
    return found


def test_it_is_a_density() -> None:
    at = np.arange(-60, 100, 0.05)
    cells = Cells(np.zeros(len(at), np.int64), np.zeros((1, 2)))
    inside = np.exp(told_apart(at_first(EXPECTED, cells), cells, at).log_density).sum() * 0.05
    assert inside == pytest.approx(1 - EXPECTED.outliers + EXPECTED.outliers * 160 / RANGE_M, abs=2e-3)


def test_low_crowns_of_a_stand_are_no_ground() -> None:
    taken, lifted, before = [], [], []
    for seed in range(8):
        cells, difference, crowns = line_of_stands(seed)
        found = fitted(cells, difference)
        ground = told_apart(found, cells, difference).ground
        taken.append(ground[crowns].mean())
        lifted.append(ground @ difference / ground.sum())
        one = noise.refitted(EXPECTED, difference, BOUNDS_M, ROUNDS, Stated(1.5, 60.0))
        alike = noise.parts(one, difference).ground
        before.append(alike @ difference / alike.sum())
    assert np.mean(taken) < 0.35
    assert abs(np.mean(lifted)) < 0.5 * np.mean(before)


def test_shares_are_those_of_the_neighbourhood() -> None:
    cells, difference, _ = line_of_stands(1)
    shares = fitted(cells, difference).shares.sum(0)
    wooded = np.arange(300) // 25 % 2 == 1
    assert shares[wooded].mean() > shares[~wooded].mean() + 0.2


def test_where_nothing_stands_sigma_is_found_again() -> None:
    rng = np.random.default_rng(2)
    cells = cells_of(np.column_stack([np.arange(400) * 10.0, np.zeros(400)]))
    found = fitted(cells, rng.normal(0, 2.0, 400))
    assert found.sigma_m == pytest.approx((0.87 * 4 + 0.13 * 2.25) ** 0.5, rel=0.08)
    assert found.noise().standing < 0.15
    assert standing.TALL_M[-1] == noise.TALLEST_M


def test_cells_are_as_large_as_leaves_so_many() -> None:
    ne = np.random.default_rng(3).uniform(-2000, 2000, (4000, 2))
    cells = cells_of(ne)
    assert MOST_WIDE_CELLS / 2 < len(cells.at_m) <= MOST_WIDE_CELLS
    assert np.hypot(*(ne - cells.at_m[cells.of]).T).max() < 4000 / np.sqrt(MOST_WIDE_CELLS) * 2
    assert np.allclose(cells.sums(ne), np.array([ne[cells.of == k].sum(0) for k in range(len(cells.at_m))]))
