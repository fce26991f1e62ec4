"""What the benchmark of cloud registration computes itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("laspy")

from benchmarks.calibrate_clouds import crossed, fitted
from benchmarks.cloud_sets.bare_clouds import BARE, write_bare_clouds
from benchmarks.cloud_sets.cloud_answers import answer_of, covered
from benchmarks.cloud_sets.cloud_cases import CloudCase, elsewhere, foreign, thinned
from benchmarks.clouds import figures, groups, number, pooled
from visloc_companion.errors import Reason
from visloc_companion.localise.registration.base import NotRegistered, Registered, RegistrationPrior

PRIOR = RegistrationPrior(10.0, 3.0, 0.05, 0.01, 0.01)
PAIR = ("suburb_fusa", "delft_ahn3")
POINTS = np.random.default_rng(1).uniform(0, 60, (2000, 3))


def case(cloud: str = "suburb_fusa") -> CloudCase:
    return CloudCase(f"{cloud}_A_00", cloud, "A", "normal", POINTS, POINTS, PRIOR, np.eye(4))


def off_by(east_m: float, p: float):
    T = np.eye(4)
    T[0, 3] = east_m
    return lambda source, reference, prior: Registered(T, np.eye(3), 0.01, 0.01, p, (("correlation", 0.5),))


def refuses(source, reference, prior):
    return NotRegistered(Reason.LOW_TEXTURE, "flat")


def test_an_answer_is_judged_by_its_distance():
    found = answer_of(off_by(3.0, 0.01), case())
    assert found.horizontal_m == pytest.approx(3.0)
    assert found.mtre_m == pytest.approx(3.0)
    assert not found.wrong
    assert answer_of(off_by(6.0, 0.01), case()).wrong
    assert answer_of(off_by(0.0, 0.01), elsewhere(case(), case("delft_ahn3"))).wrong
    assert answer_of(refuses, case()).probability_wrong == 1


def test_figures_count_refusals_as_far_and_accuracy_of_what_is_accepted():
    found = [answer_of(off_by(1.0, 0.01), case()), answer_of(off_by(20.0, 0.02), case()), answer_of(refuses, case())]
    got = figures(found, 0.05)
    assert (got["n"], got["accepted_wrong"], got["accepted_far"]) == (3, 1, 1)
    assert got["within_5m_share"] == pytest.approx(1 / 3)
    assert got["rms_error_over_sigma"] == [1.0, 0.0, 0.0]
    assert figures(found[2:], 0.05)["horizontal_median_m"] is None
    assert "accepted 2, of these 1 far" in pooled(found, 0.05)


def test_groups_hold_every_case_once_by_place_and_leave_fitted_places_out_where_they_say_so():
    found = [answer_of(off_by(1.0, 0.01), case(cloud)) for cloud in ("suburb_fusa", "delft_ahn3", "made_water")]
    sizes = {label["place"]: len(some) for label, some in groups(found)}
    assert sizes["buildings: suburb_fusa"] == sizes["buildings: delft_ahn3*"] == sizes["water: made_water"] == 1
    assert (sizes["all with information"], sizes["of these not fitted on"], sizes["of these on the reference"]) == (2, 1, 2)


def test_foreign_cases_lie_on_another_cloud_of_their_scenario_and_are_no_land():
    land = [replace(case(cloud), name=f"{cloud}_{s}_00", scenario=s) for cloud in ("suburb_fusa", "delft_ahn3") for s in "AB"]
    made = list(foreign([*land, case("made_water")]))
    assert [c.name for c in made] == [f"{a}_{s}_00_on_{b}_{s}_00" for a, b in (PAIR, PAIR[::-1]) for s in "AB"]
    assert all(c.T_true is None for c in made)
    sizes = {label["place"]: len(some) for label, some in groups([answer_of(off_by(0.0, 0.01), c) for c in made])}
    assert sizes == {"foreign: elsewhere": 2}


def test_what_lies_on_a_few_stray_returns_is_not_on_the_reference():
    rng = np.random.default_rng(3)
    source, land = rng.uniform(0, 30, (2000, 3)), rng.uniform(0, 60, (4000, 3)) + np.array([100, 0, 0])
    stray = rng.uniform(0, 60, (80, 3))
    assert covered(replace(case(), source_m=source, reference_m=np.concatenate([land, stray]))) < 0.3
    assert covered(replace(case(), source_m=source + np.array([110, 10, 0]), reference_m=np.concatenate([land, stray]))) > 0.9
    assert covered(replace(case(), T_true=None)) == 0


def test_cases_are_numbered_by_their_names():
    assert number(replace(case(), name="ign_suburb_sparse_B_07")) == 7


def test_thinning_keeps_a_density():
    side = np.ptp(POINTS[:, :2], axis=0)
    left = thinned(case(), 0.25, 0).reference_m
    assert len(left) / float(side[0] * side[1]) == pytest.approx(0.25, rel=0.15)


def test_the_logistic_fit_finds_the_weights_that_made_the_answers():
    rng = np.random.default_rng(2)
    x = np.column_stack([np.ones(6000), rng.normal(2, 3, 6000), rng.normal(0, 0.1, 6000)])
    weights = np.array([-1.0, 0.5, 8.0])
    right = (rng.random(6000) < 1 / (1 + np.exp(-x @ weights))).astype(float)
    np.testing.assert_allclose(fitted(x, right), weights, rtol=0.15)
    p = crossed(x, right, np.arange(6000) % 3)
    assert p.mean() == pytest.approx(1 - right.mean(), abs=0.01)


def test_weights_are_fitted_beside_those_that_are_held():
    rng = np.random.default_rng(5)
    x = np.column_stack([np.ones(4000), rng.normal(0.3, 1.0, (4000, 2))])
    right = (rng.random(4000) < 1 / (1 + np.exp(-x @ [0.5, 2.0, 1.0]))).astype(float)
    found = fitted(x, right, (0.5, 2.0))
    assert found[:2].tolist() == [0.5, 2.0]
    assert found[2] == pytest.approx(1.0, abs=0.15)


def test_bare_clouds_are_what_they_say(tmp_path, monkeypatch):
    monkeypatch.setattr("benchmarks.cloud_sets.bare_clouds.DENSITY", 0.05)
    folder = write_bare_clouds(tmp_path / "bare", 3)
    assert {f.stem for f in folder.glob("*.laz")} == set(BARE)
    xy = np.array([[150.0, 8.0], [150.0, 12.0], [20.0, 8.0]])
    heights = BARE["made_tree_row"](np.random.default_rng(0), xy)
    assert heights[0] > 8
    assert np.abs(heights[1:]).max() < 0.5


def test_another_clouds_reference_has_no_truth():
    assert elsewhere(case(), replace(case("delft_ahn3"))).T_true is None
