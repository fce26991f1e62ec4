"""Ground that has changed is told from ground that has not, and has no say in the place."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.consensus import LEAST_TRUST, consensus
from visloc_companion.localise.registration.height_map import HeightMap, high_passed
from visloc_companion.localise.registration.nearby import of_blocks
from visloc_companion.localise.registration.polish import polish
from visloc_companion.localise.registration.refine import refine
from visloc_companion.localise.registration.similarity import moved
from visloc_companion.localise.registration.surfaces import SourceCells, Surface, cells_of, surface_of

PRIOR = RegistrationPrior(10.0, 3.0, np.radians(1.0), np.radians(0.5), 0.01)
CENTRE = np.array([100.0, 100.0, 0.0])
SHIFT = np.array([2.0, -1.5])


def crowns(seed: int, size: int = 200, many: int = 260) -> np.ndarray:
    """(size, size) crowns of 4 to 9 m on level ground, a cell to the metre."""
    rng = np.random.default_rng(seed)
    heights = np.zeros((size, size), np.float32)
    for x, y, high in zip(rng.integers(4, size - 4, many), rng.integers(4, size - 4, many), rng.uniform(4, 9, many), strict=True):
        cv2.circle(heights, (int(x), int(y)), 3, float(high), -1)
    return np.asarray(cv2.GaussianBlur(heights, (0, 0), 1.0))


def heights_of(z: np.ndarray, corner: float) -> HeightMap:
    return HeightMap(z.astype(np.float32), np.ones(z.shape, bool), np.array([corner, corner]), 1.0)


def changed_land(seed: int, columns: int = 48) -> tuple[SourceCells, Surface, Surface, np.ndarray]:
    """A source of 96 m that belongs SHIFT away, of which so many metres in the west were planted anew; where (N,) that is."""
    before = crowns(seed)
    shifted = cv2.warpAffine(before, np.float32([[1, 0, -SHIFT[0]], [0, 1, -SHIFT[1]]]), before.shape)
    seen = shifted[52:148, 52:148] + np.random.default_rng(seed).normal(0, 0.1, (96, 96))
    seen[:, :columns] = crowns(seed + 50)[52:148, 52 : 52 + columns]
    source, reference = heights_of(seen, 52.0), heights_of(before, 0.0)
    cells = cells_of(source, high_passed(source), CENTRE)
    return cells, surface_of(reference), surface_of(high_passed(reference)), cells.points_m[:, 0] < 52.0 + columns


@pytest.mark.parametrize("seed", range(4))
def test_the_unchanged_half_names_the_shift_and_is_trusted(seed: int) -> None:
    cells, _, relief, changed = changed_land(seed)
    found = consensus(cells, relief, np.eye(4))
    np.testing.assert_allclose(found.shift_m, SHIFT, atol=0.4)
    assert found.trust.min() >= LEAST_TRUST
    assert found.trust.max() == pytest.approx(1.0)
    assert np.median(found.trust[changed]) < 0.05 * np.median(found.trust[~changed])


def test_what_changed_moves_the_place_no_more() -> None:
    """More than half was planted anew: 3 cm off where all counts. With half of it both are right to a centimetre and a half."""
    off, of_all, claimed = [], [], []
    for seed in range(8):
        cells, surface, relief, _ = changed_land(seed, 56)
        start = np.eye(4)
        start[:2, 3] = SHIFT + np.array([1.0, -1.0])
        found = refine(cells, surface, relief, start, PRIOR, 20)
        assert found is not None
        agreed = consensus(cells, relief, found.T)
        T = found.T.copy()
        T[:2, 3] += agreed.shift_m
        last = polish(cells, surface, replace(found, T=T), PRIOR, agreed.trust)
        before = polish(cells, surface, found, PRIOR, np.ones(len(cells.points_m)))
        assert last is not None
        assert before is not None
        off.append((moved(last.T, CENTRE) - CENTRE)[:2] - SHIFT)
        of_all.append((moved(before.T, CENTRE) - CENTRE)[:2] - SHIFT)
        claimed.append(np.sqrt(np.diag(last.placed)[:2]))
    assert np.sqrt(np.mean(np.square(off))) < 0.5 * np.sqrt(np.mean(np.square(of_all)))
    assert np.sqrt(np.mean(np.square(np.array(off) / claimed))) < 1.5


@pytest.mark.parametrize("columns", [0, 48, 64])
def test_blocks_favour_the_place_over_those_beside_it_however_much_has_changed(columns: int) -> None:
    cells, _, relief, _ = changed_land(1, columns)
    T = np.eye(4)
    T[:2, 3] = SHIFT
    lead, spread_m2 = of_blocks(cells, relief, T)
    assert lead > 30
    np.testing.assert_allclose(spread_m2, 0, atol=1e-6)


def test_a_place_beside_the_one_that_blocks_favour_is_as_uncertain_as_that_is_far() -> None:
    cells, _, relief, _ = changed_land(1)
    T = np.eye(4)
    T[:2, 3] = SHIFT + np.array([4.0, 0.0])
    lead, spread_m2 = of_blocks(cells, relief, T)
    assert lead < -30
    np.testing.assert_allclose(spread_m2, np.diag([16.0, 0.0]), atol=0.1)


def test_where_nothing_is_as_it_was_blocks_favour_no_place() -> None:
    cells, _, relief, _ = changed_land(1, 96)
    assert of_blocks(cells, relief, np.eye(4))[0] < 5


def test_a_level_field_says_nothing() -> None:
    flat, reference = heights_of(np.zeros((64, 64)), 52.0), heights_of(crowns(1), 0.0)
    found = consensus(cells_of(flat, high_passed(flat), CENTRE), surface_of(high_passed(reference)), np.eye(4))
    assert np.abs(found.shift_m).max() < 1e-9
    assert (found.trust == LEAST_TRUST).all()
