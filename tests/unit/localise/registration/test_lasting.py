"""Places of ground part of which has changed, by what has not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.unit.localise.registration.conftest import PRIOR, SIDE_M, TRUE_M, before_and_now, off_m, pair_of
from visloc_companion.localise.registration.base import Registered
from visloc_companion.localise.registration.choice import Choice
from visloc_companion.localise.registration.height_map import HeightMap, smoothed
from visloc_companion.localise.registration.height_search import HeightSearchRegistration
from visloc_companion.localise.registration.lasting import Lasting, lie_of
from visloc_companion.localise.registration.pair import GENTLE_M, Pair
from visloc_companion.localise.registration.search import hypotheses
from visloc_companion.localise.registration.settle import HELD_M, Settler
from visloc_companion.localise.registration.similarity import about, moved, turned, with_linear
from visloc_companion.localise.registration.slopes import ground_of


def crowns(seed: int, share: float) -> np.ndarray:
    """(SIDE_M, SIDE_M) crowns of 4 to 12 m on a share of the cells of a grid of 12 m, anew for each seed."""
    rng, grown = np.random.default_rng(seed), np.zeros((SIDE_M, SIDE_M))
    for row in range(0, SIDE_M - 12, 12):
        for col in range(0, SIDE_M - 12, 12):
            if rng.random() < share:
                v, u = row + rng.integers(0, 6), col + rng.integers(0, 6)
                grown[v : v + 5, u : u + 5] = rng.uniform(4, 12)
    return grown


def gentle(*of) -> HeightMap:
    return smoothed(HeightMap(*of), GENTLE_M)


@pytest.fixture(scope="module")
def overgrown() -> tuple[np.ndarray, np.ndarray]:
    """Source and reference of gentle ground on which other trees stand than before; the source lies TRUE_M from its place."""
    return before_and_now(crowns(1, 0.2), crowns(2, 0.2))


def there(pair: Pair, off: tuple[float, float] = (0.0, 0.0), up_m: float = 0.0) -> np.ndarray:
    return about(pair.centre_m, 0.0, 1.0, np.array([*(TRUE_M + off), up_m]))


def test_a_lie_has_slopes_and_heights_on_cells_of_two_metres():
    east, north = np.meshgrid(np.arange(60) * 0.5, np.arange(50) * 0.5)
    plane = (0.04 * east - 0.02 * north).astype(np.float32)
    lie = lie_of(gentle(plane, np.ones(plane.shape, np.bool_), np.array([100.0, 200.0]), 0.5))
    assert lie.cell_m == 2.0
    slope, height, known = lie.at(np.array([[115.0, 212.0], [0.0, 0.0]]))
    np.testing.assert_allclose(slope[0], 0.04 - 0.02j, atol=1e-4)
    assert height[0] == pytest.approx(0.04 * 14.75 - 0.02 * 11.75, abs=1e-3)
    assert known.tolist() == [True, False]


def test_ground_is_found_beside_trees_that_are_others(overgrown):
    pair = pair_of(overgrown)
    lasting = Lasting(pair, PRIOR)
    assert off_m(pair, lasting.starts(1)[0]) < 4
    away = [T for T in lasting.starts(12) if off_m(pair, T) > 20]
    assert away
    assert lasting.at(there(pair)) - max(lasting.at(T) for T in away) > 20


def test_the_likeliest_places_are_apart_and_none_is_likelier_than_the_most(overgrown):
    pair = pair_of(overgrown)
    lasting = Lasting(pair, PRIOR)
    found = lasting.starts(4)
    places = np.array([moved(T, pair.centre_m)[:2] for T in found])
    between = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    assert between[~np.eye(len(found), dtype=bool)].min() >= 6
    nats = [lasting.at(T) for T in found]
    assert nats[0] >= lasting.most > 0
    beside = there(pair, (1.5, -1.5))
    assert off_m(pair, lasting.placed(beside)) < 4
    assert lasting.at(lasting.placed(beside)) >= lasting.at(beside)


@pytest.mark.parametrize(("tilt_rad", "bowl_m", "yaw_rad"), [(0.008, 0.0, 0.0), (0.0, 0.6, 0.0), (0.0, 0.0, np.radians(20))])
def test_a_lean_a_bowl_and_a_heading_are_solved_for(overgrown, tilt_rad, bowl_m, yaw_rad):
    source, reference = overgrown
    bent = source.copy()
    bent[:, 2] += 1.5 * bowl_m * ((source[:, :2] / 33.0) ** 2).sum(1) / 2
    middle = source.mean(0)
    bent = moved(with_linear(turned(tilt_rad, 0.0, -yaw_rad), middle, middle), bent)
    prior = replace(PRIOR, sigma_yaw_rad=max(yaw_rad / 2, PRIOR.sigma_yaw_rad))
    pair = pair_of((bent, reference), prior)
    assert off_m(pair, Lasting(pair, prior).starts(1)[0]) < 5


def test_a_place_that_lies_too_high_is_less_likely_but_not_without_end(overgrown):
    source, reference = overgrown
    at = [Lasting(pair := pair_of((source - [0, 0, up], reference)), PRIOR).at(there(pair)) for up in (0.0, 6.0, 60.0)]
    assert at[0] - at[1] == pytest.approx(36 / (2 * (9 + 1)), abs=0.5)
    assert at[0] - at[2] == pytest.approx(15, abs=0.5)


def test_where_little_is_known_of_the_ground_nothing_is_said(overgrown):
    source, reference = overgrown
    pair = pair_of((source, reference[reference[:, 0] < -40]))
    lasting = Lasting(pair, PRIOR)
    assert lasting.at(there(pair)) == 0
    assert lasting.at(there(pair, (1e4, 0.0))) == 0
    pair = pair_of((source, reference + np.array([290.0, 0.0, 0.0])))
    lasting = Lasting(pair, PRIOR)
    assert (lasting.starts(4), lasting.most, lasting.at(np.eye(4))) == ([], 0.0, 0.0)


def test_a_place_that_the_ground_tells_is_taken_and_not_believed_for_that(overgrown):
    source, reference = overgrown
    found = HeightSearchRegistration(1.0)(source, reference, PRIOR)
    assert isinstance(found, Registered)
    assert np.hypot(*(moved(found.T_reference_source, source).mean(0) - source.mean(0))[:2] - TRUE_M) < 4
    assert found.probability_wrong > 0.05


def test_a_place_of_the_ground_is_a_candidate_as_it_is_and_loosely_held(overgrown):
    pair = pair_of(overgrown)
    settler = Settler(pair, PRIOR)
    (held,) = settler.held([there(pair, (1.0, 0.0))])
    assert off_m(pair, held.refined.T) == pytest.approx(1.0)
    assert held.refined.placed[:2, :2].diagonal().min() > HELD_M**2
    assert settler.held([there(pair, (1e4, 0.0))]) == []


def test_last_steps_that_lose_the_ground_have_strayed_and_without_a_doubt_none_have(overgrown):
    pair = pair_of(overgrown)
    here, beside = Settler(pair, PRIOR).held([there(pair), there(pair, (12.0, 0.0))])
    choice = Choice(pair, PRIOR)
    assert not choice.strayed(beside, here)
    assert choice.by_ground() == []
    assert choice.doubted(beside)
    assert choice.strayed(beside, here)
    assert not choice.strayed(here, beside)
    assert off_m(pair, choice.by_ground()[0]) < 2


def test_a_place_leads_the_likeliest_other_one_or_chance(overgrown):
    pair = pair_of(overgrown)
    lasting = Lasting(pair, PRIOR)
    best, second = lasting.starts(2)
    assert lasting.lead(best) > 0 > lasting.lead(second)
    assert lasting.lead(there(pair), [there(pair, (0.5, 0.0))]) == pytest.approx(lasting.lead(there(pair)), abs=2)
    far = [T for T in lasting.starts(24) if off_m(pair, T) > 20][-1]
    assert lasting.lead(far, [there(pair)]) <= lasting.at(lasting.placed(far)) - lasting.at(there(pair)) + 1
    nowhere = pair_of((overgrown[0], overgrown[1] + np.array([290.0, 0.0, 0.0])))
    pairs = hypotheses(nowhere.half_m, lie_of(nowhere.gentle[1]).cell_m, PRIOR)
    assert Lasting(nowhere, PRIOR).lead(there(nowhere)) == pytest.approx(-np.log(len(pairs)))


def test_the_evidence_names_the_lead_of_the_unchanged_ground_where_a_place_is_doubtful(overgrown, scene):
    doubtful = HeightSearchRegistration(1.0)(*overgrown, PRIOR)
    clear = HeightSearchRegistration(1.0)(scene.source_m, scene.reference_m, scene.prior)
    assert dict(doubtful.evidence)["lasting_lead"] > 2
    assert dict(clear.evidence)["lasting_lead"] == 0


def test_surfaces_are_evened_out_once_for_both_looks_at_the_ground(overgrown, monkeypatch):
    evened = []
    monkeypatch.setattr(
        "visloc_companion.localise.registration.pair.smoothed",
        lambda heights, sigma_m: evened.append(sigma_m) or smoothed(heights, sigma_m),
    )
    pair = pair_of(overgrown)
    evened.clear()
    assert ground_of(pair, PRIOR).nats.size
    assert Lasting(pair, PRIOR).most > 0
    assert evened == [GENTLE_M, GENTLE_M]
