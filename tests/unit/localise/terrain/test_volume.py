"""The search by FFT is the sum that it stands for, and thinning keeps a low point with its place."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from visloc_companion.localise.search import NO_SCORE
from visloc_companion.localise.terrain.base import Soundings
from visloc_companion.localise.terrain.information import expected_sigma_m
from visloc_companion.localise.terrain.noise import HeightNoise, expected_log_density, parts
from visloc_companion.localise.terrain.settings import TerrainSettings
from visloc_companion.localise.terrain.thin import lowest
from visloc_companion.localise.terrain.volume import Stretch, search


def test_scores_are_sums_of_log_densities(world: SimpleNamespace) -> None:
    ground, noise = world.waves(20), HeightNoise(2.0)
    terrain = world.elevation(ground).window((0.0, 0.0), (500.0, 500.0), 20.0)
    cells = np.random.default_rng(1).integers(-10, 11, (200, 2))
    height = ground(cells * 20.0 + np.array([40.0, -60.0])) + 3.2
    stretch = Stretch(cells * 20.0, height)
    got = search(terrain, [stretch], noise, (0.0, 0.0), (100.0, 100.0), 6.0, 0.1)
    row, col = np.unravel_index(int(np.argmax(got.scores.score)), got.scores.score.shape)
    place = terrain.first_ne_m + (np.array([row + got.scores.origin_px[1], col + got.scores.origin_px[0]])) * 20.0
    assert place == pytest.approx([40, -60])
    assert got.offset_m[row, col] == pytest.approx(3.2)

    def direct(place: np.ndarray, offset: float) -> float:
        d = height - terrain.heights(cells * 20.0 + place) - offset
        return 0.1 * float((parts(noise, d).log_density - expected_log_density(noise)).sum()) - 0.5 * (offset / 6) ** 2

    beside = got.scores.score[row + 2, col + 1] - got.scores.score[row, col]
    wanted = direct(place + np.array([40.0, 20.0]), float(got.offset_m[row + 2, col + 1])) - direct(
        place, float(got.offset_m[row, col])
    )
    assert beside == pytest.approx(wanted, abs=0.1 * abs(wanted) + 0.3)


def test_places_off_the_model_have_no_score(world: SimpleNamespace) -> None:
    terrain = world.elevation(world.waves(8), half_m=200.0).window((0.0, 0.0), (900.0, 900.0), 20.0)
    cells = np.random.default_rng(1).integers(-5, 6, (100, 2))
    got = search(terrain, [Stretch(cells * 20.0, np.full(100, 250.0))], HeightNoise(2.0), (0.0, 0.0), (600.0, 600.0), 6.0, 0.1)
    assert got.scores.score[0, 0] == NO_SCORE
    assert got.scores.score[30, 30] > NO_SCORE


def test_a_low_point_of_a_cell_keeps_its_place() -> None:
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(0, 100, (4000, 2)), rng.uniform(0, 20, 4000)])
    kept = lowest(Soundings(1, points, np.arange(4000.0), 0.3), 10.0)
    assert len(kept.points_m) == 100
    assert kept.points_m[:, 2].max() < 6
    assert (points[kept.age_s.astype(int)] == kept.points_m).all()
    assert len(lowest(Soundings(1, points, np.zeros(4000), 0.3), 1.0, most=500).points_m) <= 500


def test_rough_ground_promises_more_than_level_ground(world: SimpleNamespace) -> None:
    rough, level = (
        expected_sigma_m(world.patch(ground), world.prior(), world.elevation(ground), TerrainSettings())
        for ground in (world.waves(30), world.waves(0.3))
    )
    assert rough < 3
    assert level > 10
    void = world.elevation(world.waves(30), half_m=100)
    assert expected_sigma_m(world.patch(world.waves(30)), world.prior(at=(9000.0, 0.0)), void, TerrainSettings()) == np.inf
