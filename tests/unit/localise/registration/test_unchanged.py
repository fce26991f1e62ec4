"""Places of stereo clouds over land much of which has changed."""

from __future__ import annotations

import numpy as np
import pytest

from tests.unit.localise.registration import test_nearby
from tests.unit.localise.registration.conftest import SIDE_M, before_and_now, off_m, pair_of
from visloc_companion.localise.flight import flight_registration
from visloc_companion.localise.registration.base import NotRegistered, Registered, RegistrationPrior
from visloc_companion.localise.registration.consensus import beside
from visloc_companion.localise.registration.height_search import HeightSearchRegistration
from visloc_companion.localise.registration.search import find_places
from visloc_companion.localise.registration.settle import Settled, Settler
from visloc_companion.localise.registration.similarity import moved
from visloc_companion.localise.registration.surfaces import surface_of
from visloc_companion.localise.registration.unchanged import CLEAR_LEAD, Unchanged, is_clear
from visloc_companion.localise.structure.claims import judged

PRIOR = RegistrationPrior(20.0, 3.0, np.radians(1.0), np.radians(0.5), 0.005, gaussian=True)
Clouds = tuple[np.ndarray, np.ndarray]


def trees(seed: int) -> np.ndarray:
    """(SIDE_M, SIDE_M) crowns on a few of the cells of a grid of 12 m, others for each seed."""
    rng, grown = np.random.default_rng(seed), np.zeros((SIDE_M, SIDE_M))
    for row in range(0, SIDE_M - 12, 12):
        for col in range(0, SIDE_M - 12, 12):
            if rng.random() < 0.08:
                v, u = row + rng.integers(0, 6), col + rng.integers(0, 6)
                grown[v : v + 5, u : u + 5] = rng.uniform(4, 12)
    return grown


@pytest.fixture(scope="module")
def replanted() -> Clouds:
    """Source and reference of gentle ground on which all trees are others."""
    return before_and_now(trees(1), trees(2))


def test_ground_is_found_where_nothing_that_stands_is_as_it_was(replanted: Clouds) -> None:
    by_score, by_all = (HeightSearchRegistration(1.0, by_score=True, by_unchanged=by)(*replanted, PRIOR) for by in (False, True))
    pair = pair_of(replanted)
    assert isinstance(by_all, Registered)
    assert off_m(pair, by_all.T_reference_source) < 3
    assert dict(by_all.evidence)["unchanged_lead"] > 60
    assert not isinstance(by_score, Registered) or off_m(pair, by_score.T_reference_source) > 6


def test_what_the_ground_tells_is_believed_in_flight(replanted: Clouds) -> None:
    found = flight_registration()(*replanted, PRIOR)
    assert isinstance(found, Registered)
    assert isinstance(judged(found, 0.05), Registered)


def test_mirrored_ground_is_no_place(replanted: Clouds) -> None:
    source, reference = replanted
    found = flight_registration()(source * [1, -1, 1], reference, PRIOR)
    assert isinstance(found, NotRegistered) or isinstance(judged(found, 0.05), NotRegistered)


def test_what_is_clear_is_not_asked_for(scene) -> None:
    once, twice = (
        HeightSearchRegistration(1.0, by_score=True, by_unchanged=by)(scene.source_m, scene.reference_m, scene.prior)
        for by in (False, True)
    )
    assert isinstance(once, Registered)
    assert isinstance(twice, Registered)
    assert twice.T_reference_source.tobytes() == once.T_reference_source.tobytes()
    assert dict(twice.evidence)["unchanged_lead"] == 0.0


def test_a_place_is_clear_by_its_lead_over_other_places_alone(scene) -> None:
    settler = Settler(pair_of((scene.source_m, scene.reference_m), scene.prior), scene.prior)
    best, other = settler.settled(place.T for place in find_places(settler.pair, scene.prior, 2)[0])
    assert best.found.score - other.found.score > CLEAR_LEAD
    assert is_clear(best, [best, other], settler)
    assert not is_clear(other, [best, other], settler)


@pytest.mark.parametrize("heights", [test_nearby.dam, test_nearby.orchard])
def test_ground_that_is_alike_beside_a_place_is_refused(heights: test_nearby.Heights) -> None:
    source, reference = test_nearby.clouds(heights, np.array([-2.0, 2.5]))
    found = flight_registration()(source, reference, test_nearby.PRIOR)
    assert isinstance(found, NotRegistered) or isinstance(judged(found, 0.05), NotRegistered)


def test_the_prior_counts_among_places_that_are_alike(replanted: Clouds) -> None:
    settler = Settler(pair_of(replanted, PRIOR), PRIOR)
    near, far = (Unchanged(Settler(settler.pair, prior)) for prior in (PRIOR, RegistrationPrior(10.0, *rest_of(PRIOR))))
    T = near.likeliest([])[0].T
    off = np.square((moved(T, settler.pair.centre_m) - settler.pair.centre_m)[:2]).sum()
    assert near.nats(T) - far.nats(T) == pytest.approx(off * (1 / 10.0**2 - 1 / 20.0**2) / 2, rel=0.01)


def rest_of(prior: RegistrationPrior) -> tuple[float, float, float, float, float, bool]:
    """All of a prior but its horizontal sigma."""
    return prior.sigma_vertical_m, prior.sigma_yaw_rad, prior.sigma_tilt_rad, prior.sigma_scale, 0.0, True


def test_blocks_are_asked_as_far_and_as_densely_as_is_wished(scene) -> None:
    pair = pair_of((scene.source_m, scene.reference_m), scene.prior)
    settler, relief = Settler(pair, scene.prior), surface_of(pair.reference_relief)
    all_of, some = (beside(settler.cells, relief, scene.T_true, 7.9 * pair.reference.cell_m, step) for step in (1, 2))
    assert (len(all_of.nats), len(some.nats)) == (17, 9)
    np.testing.assert_allclose(some.nats, all_of.nats[::2, ::2], rtol=1e-6)
    np.testing.assert_allclose(some.at_m, all_of.at_m[::2, ::2])
    assert all_of.nats[8, 8] == beside(settler.cells, relief, scene.T_true, 0.0).nats[0, 0]


def test_the_place_that_the_score_had_taken_is_a_rival_of_the_one_that_is_taken_instead(
    replanted: Clouds, monkeypatch: pytest.MonkeyPatch
) -> None:
    compared, answer = [], Settler.answer

    def recorded(settler: Settler, best: Settled, rest: list[Settled], *more: object) -> object:
        compared.append([best, *rest])
        return answer(settler, best, rest, *more)

    monkeypatch.setattr(Settler, "answer", recorded)
    for by in (False, True):
        HeightSearchRegistration(1.0, by_score=True, by_unchanged=by)(*replanted, PRIOR)
    by_score, by_all = compared
    best = max(one.found.score for one in by_score[1:])
    assert by_all[0].found.score < best
    assert len(by_all) > len(by_score)
