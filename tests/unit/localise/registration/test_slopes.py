"""Places of ground on which nothing stands, by its slopes."""

from __future__ import annotations

import numpy as np
import pytest

from tests.unit.localise.registration.conftest import PRIOR, SIDE_M, TRUE_M, before_and_now, off_m, pair_of
from visloc_companion.localise.registration.base import Registered, RegistrationPrior
from visloc_companion.localise.registration.choice import Choice
from visloc_companion.localise.registration.correlation import Scores, peaks
from visloc_companion.localise.registration.height_map import HeightMap, smoothed
from visloc_companion.localise.registration.height_search import HeightSearchRegistration
from visloc_companion.localise.registration.pair import GENTLE_M, Pair, make_pair
from visloc_companion.localise.registration.search import APART_M
from visloc_companion.localise.registration.similarity import about, moved, turned, with_linear
from visloc_companion.localise.registration.slopes import Ground, ground_of, slopes_of


def fields(seed: int) -> np.ndarray:
    """(SIDE_M, SIDE_M) crops of four parcels, up to 1 m high, parted at random."""
    rng, crops = np.random.default_rng(seed), np.zeros((SIDE_M, SIDE_M))
    u, v = rng.integers(SIDE_M // 3, 2 * SIDE_M // 3, 2)
    for rows in (slice(None, v), slice(v, None)):
        for cols in (slice(None, u), slice(u, None)):
            crops[rows, cols] = rng.uniform(0, 1)
    return crops


def gentle(*of) -> HeightMap:
    return smoothed(HeightMap(*of), GENTLE_M)


@pytest.fixture(scope="module")
def farmland() -> tuple[np.ndarray, np.ndarray]:
    """Source and reference of gentle ground with other parcels than before; the source lies TRUE_M from where it belongs."""
    return before_and_now(fields(1), fields(2))


def likeliest(pair: Pair, ground: Ground, most: int) -> list[np.ndarray]:
    """(4, 4) The likeliest places."""
    found, of = [], ground.reference
    scores = Scores(ground.nats, np.zeros(ground.nats.shape, np.int32), ground.origin)
    for u, v, _, _ in peaks(scores, APART_M / of.cell_m, most):
        to = of.corner_m + of.cell_m * (np.array([u, v]) + 0.5)
        found.append(about(pair.centre_m, 0.0, 1.0, np.append(to - pair.centre_m[:2], 0.0)))
    return found


def test_slopes_are_rise_over_run_to_the_east_and_north():
    east, north = np.meshgrid(np.arange(60) * 1.5, np.arange(50) * 1.5)
    plane = (0.04 * east - 0.02 * north).astype(np.float32)
    found = slopes_of(gentle(plane, np.ones(plane.shape, np.bool_), np.array([100.0, 200.0]), 1.5))
    assert found.cell_m == 1.5
    np.testing.assert_allclose(found.slope[15:-15, 15:-15], 0.04 - 0.02j, atol=1e-4)
    coarse = slopes_of(gentle(plane, np.ones(plane.shape, np.bool_), np.array([100.0, 200.0]), 0.5))
    assert coarse.cell_m == 2.0
    np.testing.assert_allclose(coarse.corner_m + coarse.cell_m / 2, np.array([100.0, 200.0]) + 2.5 * 0.5)


def test_what_stands_and_ends_hardly_counts_beside_the_ground():
    plane = (0.03 * np.arange(80) * np.ones((80, 1))).astype(np.float32)
    plane[38:43, 38:43] += 5.0
    found = slopes_of(gentle(plane, np.ones(plane.shape, np.bool_), np.zeros(2), 1.0))
    assert np.abs(found.slope[19, 19:21] - 0.03).max() < 0.01


def test_ground_on_which_only_crops_stand_is_found_by_its_slopes(farmland):
    pair = pair_of(farmland)
    ground = ground_of(pair, PRIOR)
    assert off_m(pair, likeliest(pair, ground, 1)[0]) < 4
    away = [T for T in likeliest(pair, ground, 4) if off_m(pair, T) > 10]
    assert ground.at(likeliest(pair, ground, 1)[0]) == pytest.approx(ground.nats.max())
    assert ground.nats.max() - max(ground.at(T) for T in away) > 5


def test_ground_leads_where_it_lies_so_and_at_no_other_place(farmland):
    pair = pair_of(farmland)
    ground = ground_of(pair, PRIOR)
    best, second = likeliest(pair, ground, 2)
    by_chance = np.log(ground.nats.size * 4 / (36 * np.pi) * len(ground.pairs))
    assert ground.at(second) < by_chance
    assert ground.lead(best) == pytest.approx(ground.nats.max() - by_chance)
    assert ground.lead(best) > 5 > -5 > ground.lead(second)


def test_the_evidence_names_the_lead_of_the_ground_where_a_place_is_doubtful(farmland, scene):
    doubtful = HeightSearchRegistration(1.0)(*farmland, PRIOR)
    clear = HeightSearchRegistration(1.0)(scene.source_m, scene.reference_m, scene.prior)
    assert dict(doubtful.evidence)["ground_lead"] > 5
    assert dict(clear.evidence)["ground_lead"] == 0


def test_a_doubtful_place_is_taken_where_the_slopes_lead_to(farmland):
    source, reference = farmland
    found = HeightSearchRegistration(1.0)(source, reference, PRIOR)
    assert isinstance(found, Registered)
    assert np.hypot(*(moved(found.T_reference_source, source).mean(0) - source.mean(0))[:2] - TRUE_M) < 4
    assert found.probability_wrong > 0.05


@pytest.mark.parametrize(("tilt_rad", "bowl_m", "yaw_rad"), [(0.008, 0.0, 0.0), (0.0, 0.6, 0.0), (0.0, 0.0, np.radians(80))])
def test_a_lean_a_bowl_and_a_heading_are_taken_out(farmland, tilt_rad, bowl_m, yaw_rad):
    source, reference = farmland
    bent = source.copy()
    bent[:, 2] += 1.5 * bowl_m * ((source[:, :2] / 33.0) ** 2).sum(1) / 2
    middle = source.mean(0)
    bent = moved(with_linear(turned(tilt_rad, 0.0, -yaw_rad), middle, middle), bent)
    prior = RegistrationPrior(40.0, 3.0, np.radians(3.0) if not yaw_rad else np.radians(30), np.radians(0.5), 0.01)
    pair = pair_of((bent, reference), prior)
    assert off_m(pair, likeliest(pair, ground_of(pair, prior), 1)[0]) < 5


def test_where_little_is_known_of_the_slopes_nothing_is_said(farmland):
    source, reference = farmland
    pair = pair_of((source, reference[reference[:, 0] < -40]))
    ground = ground_of(pair, PRIOR)
    beside = np.eye(4)
    beside[:2, 3] = TRUE_M
    assert ground.at(beside) == 0
    beside[0, 3] = 1e4
    assert ground.at(beside) == 0


def test_where_the_prior_reaches_no_place_on_the_reference_there_is_none(farmland):
    source, reference = farmland
    pair = pair_of((source, reference + np.array([290.0, 0.0, 0.0])))
    ground = ground_of(pair, PRIOR)
    assert ground.nats.shape == (0, 0)
    assert (likeliest(pair, ground, 4), ground.at(np.eye(4))) == ([], 0.0)


def test_without_a_doubt_no_slopes_are_asked_for(scene, monkeypatch):
    def asked(*_):
        raise AssertionError

    monkeypatch.setattr("visloc_companion.localise.registration.choice.ground_of", asked)
    assert isinstance(HeightSearchRegistration(1.0)(scene.source_m, scene.reference_m, scene.prior), Registered)
    pair = make_pair(scene.source_m, scene.reference_m, scene.prior)
    assert isinstance(pair, Pair)
    assert Choice(pair, scene.prior)
