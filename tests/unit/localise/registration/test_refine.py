from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.height_map import HeightMap, high_passed
from visloc_companion.localise.registration.polish import polish
from visloc_companion.localise.registration.refine import refine, robust
from visloc_companion.localise.registration.similarity import about, moved, scale_of, tilt_of, turned, with_linear
from visloc_companion.localise.registration.surfaces import IN_REFERENCE, SourceCells, cells_of, met, surface_of

PRIOR = RegistrationPrior(10.0, 3.0, np.radians(3.0), np.radians(2.0), 0.012)


def relief(rows: np.ndarray, cols: np.ndarray) -> np.ndarray:
    return 2.0 * np.sin(cols / 4.3) * np.cos(rows / 5.1) + 1.5 * np.sin((rows + 2 * cols) / 7.7)


def height_map(size: int, corner: tuple[float, float], shift: tuple[float, float] = (0, 0), up: float = 0.0) -> HeightMap:
    rows, cols = np.indices((size, size)).astype(float)
    z = relief(rows + corner[1] + shift[1], cols + corner[0] + shift[0]) + up
    return HeightMap(z.astype(np.float32), np.ones((size, size), bool), np.array(corner, float), 1.0)


def parts(source: HeightMap):
    reference = height_map(120, (0, 0))
    centre = np.array([60.0, 60.0, 0.0])
    return cells_of(source, high_passed(source), centre), surface_of(reference), surface_of(high_passed(reference)), centre


def alike(cells: SourceCells) -> np.ndarray:
    return np.ones(len(cells.points_m))


def test_finds_shift_height_and_heading():
    cells, surface, of_relief, centre = parts(height_map(50, (35, 35), (1.5, -1.0), -2.0))
    found = refine(cells, surface, of_relief, np.eye(4), PRIOR, 20)
    np.testing.assert_allclose(moved(found.T, centre) - centre, [1.5, -1.0, 2.0], atol=0.2)
    last = polish(cells, surface, found, PRIOR, alike(cells))
    np.testing.assert_allclose(moved(last.T, centre) - centre, [1.5, -1.0, 2.0], atol=0.05)
    turned_start = about(centre, 0.03, 1.01, np.zeros(3))
    again = refine(cells, surface, of_relief, turned_start, PRIOR, 20)
    np.testing.assert_allclose(again.T[:3, :3], found.T[:3, :3], atol=2e-3)


def test_noise_of_the_source_does_not_shrink_it():
    source = height_map(80, (20, 20))
    rng = np.random.default_rng(2)
    found = []
    for _ in range(4):
        noisy = source.height_m + rng.normal(0, 2.0, source.height_m.shape).astype(np.float32)
        cells, surface, of_relief, _ = parts(replace(source, height_m=noisy))
        first = refine(cells, surface, of_relief, np.eye(4), replace(PRIOR, sigma_scale=0.1), 20)
        last = polish(cells, surface, first, replace(PRIOR, sigma_scale=0.1), alike(cells))
        found.append((scale_of(first.T), scale_of(last.T)))
    of_first, of_last = np.mean(found, axis=0)
    assert of_first == pytest.approx(1, abs=0.02), "0.954 by slopes from the source's own heights"
    assert of_last == pytest.approx(1, abs=0.006), "0.938"


def test_no_steps_is_a_look():
    cells, surface, of_relief, _ = parts(height_map(50, (35, 35), (1.5, -1.0)))
    assert np.array_equal(refine(cells, surface, of_relief, np.eye(4), PRIOR, 0).T, np.eye(4))


def test_what_was_built_moves_nothing_and_a_bowl_is_seen():
    source = height_map(50, (35, 35), (1.0, 0.5))
    changed = source.height_m.copy()
    changed[8:22, 10:26] += 6
    rows, cols = np.indices(changed.shape)
    changed += (0.002 * ((rows - 24.5) ** 2 + (cols - 24.5) ** 2)).astype(np.float32)
    cells, surface, of_relief, centre = parts(replace(source, height_m=changed))
    first = refine(cells, surface, of_relief, np.eye(4), PRIOR, 20)
    last = polish(cells, surface, first, PRIOR, alike(cells))
    off = moved(last.T, centre) - centre
    np.testing.assert_allclose(off[:2], [1.0, 0.5], atol=0.05)
    assert last.bowl_m < -0.3


def test_tilt_is_found_within_its_prior_and_held_where_the_prior_is_sharp():
    cells, surface, of_relief, centre = parts(height_map(50, (35, 35)))
    tilt = with_linear(turned(0.03, -0.02, 0.0), centre, centre)
    free = refine(cells, surface, of_relief, tilt, PRIOR, 20)
    assert np.abs(tilt_of(free.T)).max() < 2e-3
    sharp = refine(cells, surface, of_relief, np.eye(4), replace(PRIOR, sigma_tilt_rad=1e-6), 20)
    assert np.abs(tilt_of(sharp.T)).max() < 1e-6


def test_a_plane_tells_nothing_of_the_place():
    flat = height_map(50, (35, 35))
    flat = replace(flat, height_m=np.zeros_like(flat.height_m))
    plane = replace(height_map(120, (0, 0)), height_m=np.zeros((120, 120), np.float32))
    cells = cells_of(flat, flat, np.array([60.0, 60.0, 0.0]))
    found = refine(cells, surface_of(plane), surface_of(plane), np.eye(4), PRIOR, 5)
    assert np.sqrt(np.linalg.eigvalsh(found.placed[:2, :2])[-1]) > 100


def test_nothing_in_common_is_no_answer():
    cells, surface, of_relief, centre = parts(height_map(50, (35, 35)))
    away = about(centre, 0.0, 1.0, np.array([500.0, 0, 0]))
    assert refine(cells, surface, of_relief, away, PRIOR, 5) is None


def test_growth_widens_what_counts_as_alike():
    cells, surface, of_relief, _ = parts(height_map(50, (35, 35), (0.5, 0.0)))
    grown = refine(cells, surface, of_relief, np.eye(4), replace(PRIOR, sigma_growth_m=2.0), 20)
    assert grown.height_sigma_m == pytest.approx(2.0)


def test_where_little_stands_out_the_deviation_is_that_of_what_does():
    lawn, crowns = np.full(900, 0.02), np.tile([-1.0, 1.0], 50)
    residual, slope = np.append(lawn, crowns), np.append(np.full(900, 0.001), np.full(100, 1.0))
    of_all, lost = robust(residual, 0.0)
    of_crowns, kept = robust(residual, 0.0, slope)
    assert of_all == pytest.approx(0.1), "the least"
    assert of_crowns == pytest.approx(1.48, abs=0.05)
    assert lost[900:].max() < 0.01
    assert kept[900:].min() > 0.7


@pytest.mark.parametrize("n", [1, 2, 7, 8, 1001, 1002])
def test_the_robust_deviation_is_of_the_median_to_the_bit(n):
    residual = np.random.default_rng(n).standard_normal(n)
    off = np.abs(residual - np.median(residual))
    sigma, weight = robust(residual, 0.0)
    assert sigma == max(0.1, 1.4826 * np.median(off))
    assert np.array_equal(weight, 1 / np.square(1 + np.square(off / (2.0 * sigma))))


@pytest.mark.parametrize("east_m", [0.0, 45.0], ids=["all on the reference", "in part beside it"])
@pytest.mark.parametrize("bowl_m", [0.0, 0.7])
def test_cells_meet_the_surface_where_the_similarity_puts_them(bowl_m, east_m):
    cells, surface, _, centre = parts(height_map(50, (35, 35)))
    T = about(centre, 0.03, 1.01, np.array([east_m, 1.0, 2.0]))
    on = met(cells, surface, T, bowl_m)
    at = moved(T, cells.points_m + np.outer(bowl_m * cells.bowl, [0, 0, 1]))
    layers = surface.at(at[:, :2])
    assert np.array_equal(on.used, layers[:, 3] > IN_REFERENCE)
    assert on.used.all() == (east_m == 0.0) and on.used.any()
    assert np.array_equal(on.at_m, at[on.used])
    assert np.array_equal(on.out_m, at[on.used] - moved(T, centre))
    for found, layer in ((on.height_m, 0), (on.east, 1), (on.north, 2)):
        assert np.array_equal(found, layers[on.used, layer])
