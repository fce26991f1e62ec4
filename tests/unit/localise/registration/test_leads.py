"""How far a place leads: by the parts of the source, by those of its finer relief, and by all looks at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.localise.registration.base import Registered
from visloc_companion.localise.registration.handicap import NATS
from visloc_companion.localise.registration.height_search import HeightSearchRegistration
from visloc_companion.localise.registration.leads import leads_of
from visloc_companion.localise.registration.pair import make_pair
from visloc_companion.localise.registration.similarity import about, moved


@pytest.fixture(scope="module")
def pair(scene):
    return make_pair(scene.source_m, scene.reference_m, scene.prior)


def parts_lead(pair, T, prior) -> float:
    return leads_of(pair, T, prior).parts


def shifted(T: np.ndarray, east_m: float, north_m: float) -> np.ndarray:
    there = T.copy()
    there[:2, 3] += [east_m, north_m]
    return there


def test_parts_lead_at_the_right_place_and_at_no_other(scene, pair):
    right = parts_lead(pair, scene.T_true, scene.prior)
    assert right > 0.4
    for east_m, north_m in ((9.0, 0.0), (-7.0, -8.0), (0.0, 30.0)):
        assert parts_lead(pair, shifted(scene.T_true, east_m, north_m), scene.prior) < -0.4


def test_a_place_between_cells_is_itself_and_no_rival(scene, pair):
    at, beside = (parts_lead(pair, shifted(scene.T_true, off, off), scene.prior) for off in (0.0, 0.5))
    assert beside == pytest.approx(at, abs=0.05)


def test_a_tall_thing_that_is_new_costs_its_own_part_alone(scene, pair):
    """The correlation of the whole is made by what stands highest."""
    source = scene.source_m.copy()
    middle = source[:, :2].mean(0) + np.array([10.0, 5.0])
    source[(np.abs(source[:, :2] - middle) < 4.0).all(1), 2] += 25.0
    built = make_pair(source, scene.reference_m, scene.prior)
    assert parts_lead(built, scene.T_true, scene.prior) > 0.7 * parts_lead(pair, scene.T_true, scene.prior)
    found = HeightSearchRegistration(1.0)(source, scene.reference_m, scene.prior)
    assert isinstance(found, Registered)
    evidence = dict(found.evidence)
    assert evidence["correlation"] - evidence["rival"] < 0.3


def test_nothing_leads_beyond_the_region_of_the_prior(scene, pair):
    assert parts_lead(pair, shifted(scene.T_true, 500.0, 0.0), scene.prior) < -0.4
    assert parts_lead(pair, scene.T_true, replace(scene.prior, sigma_horizontal_m=1.0)) < 0


def test_a_gaussian_prior_takes_their_handicap_from_places(scene):
    """The right place is where the prior has it; its rivals are not."""
    gaussian = replace(scene.prior, sigma_horizontal_m=15.0, gaussian=True)
    pair = make_pair(moved(scene.T_true, scene.source_m), scene.reference_m, gaussian)
    lead = parts_lead(pair, np.eye(4), gaussian)
    assert 0.005 < lead - parts_lead(pair, np.eye(4), replace(gaussian, gaussian=False)) < 9 * 2 / 2 / NATS


def test_level_ground_has_no_lead(scene):
    rng = np.random.default_rng(3)
    flat = [np.column_stack([rng.uniform(-s, s, (n, 2)), rng.normal(0, 0.02, n)]) for s, n in ((30, 9000), (75, 40_000))]
    pair = make_pair(*flat, scene.prior)
    assert abs(parts_lead(pair, np.eye(4), scene.prior)) < 0.1


def test_looks_together_lead_at_the_right_place_and_at_no_other(scene, pair):
    right = leads_of(pair, scene.T_true, scene.prior)
    assert right.joint > 1.0
    for east_m, north_m in ((9.0, 0.0), (-7.0, -8.0), (0.0, 30.0)):
        assert leads_of(pair, shifted(scene.T_true, east_m, north_m), scene.prior).joint < -1.0


def test_the_rival_that_leads_by_all_looks_is_named(scene, pair):
    """From a wrong place it is the right one; from the right one it is another place."""
    there = moved(scene.T_true, pair.centre_m)[:2]
    wrong = leads_of(pair, shifted(scene.T_true, 20.0, 0.0), scene.prior)
    assert np.hypot(*(np.array(wrong.rival_m) - there)) < 1.5
    right = leads_of(pair, scene.T_true, scene.prior)
    assert np.hypot(*(np.array(right.rival_m) - there)) >= 5.5


def test_a_place_that_agrees_as_well_turned_is_led_by_nothing(scene, pair):
    same = about(pair.centre_m, 0.0, 1.0, np.zeros(3)) @ scene.T_true
    lead = leads_of(pair, scene.T_true, scene.prior, [same])
    assert max(lead.parts, lead.joint) < 0.05
    away = leads_of(pair, scene.T_true, scene.prior, [shifted(scene.T_true, 500.0, 0.0)])
    assert away == leads_of(pair, scene.T_true, scene.prior)


def test_where_nothing_is_searched_nothing_leads(scene, pair):
    far = replace(pair, centre_m=pair.centre_m + np.array([1e4, 0, 0]))
    assert leads_of(far, scene.T_true, scene.prior) == leads_of(far, np.eye(4), scene.prior)
    assert leads_of(far, scene.T_true, scene.prior).joint == 0


def test_what_agrees_more_than_by_chance_is_rare_where_other_places_tell_what_is_chance(scene, pair):
    assert leads_of(pair, scene.T_true, scene.prior).rare > 3.0
    for east_m, north_m in ((9.0, 0.0), (0.0, 30.0)):
        assert leads_of(pair, shifted(scene.T_true, east_m, north_m), scene.prior).rare < -2.0
    turned = about(pair.centre_m, 0.0, 1.0, np.zeros(3)) @ scene.T_true
    assert leads_of(pair, scene.T_true, scene.prior, [turned]).rare < 0.05
    narrow = replace(scene.prior, sigma_horizontal_m=2.0)
    right_there = make_pair(moved(scene.T_true, scene.source_m), scene.reference_m, narrow)
    lead = leads_of(right_there, np.eye(4), narrow)
    assert (lead.rare, lead.joint > 1.0) == (0.0, True)
