from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.localise.registration.base import NotRegistered, Registered, RegistrationPrior
from visloc_companion.localise.registration.correlation import NO_SCORE, Scores
from visloc_companion.localise.registration.handicap import of_similarity
from visloc_companion.localise.registration.height_search import HeightSearchRegistration
from visloc_companion.localise.registration.pair import make_pair
from visloc_companion.localise.registration.registry import make_registration
from visloc_companion.localise.registration.search import find_places, hypotheses, runner_up, search, template, work
from visloc_companion.localise.registration.similarity import moved, yaw_of


def test_hypotheses_cover_three_sigma_by_steps_of_the_edge(scene):
    pairs = hypotheses(30.0, 1.0, scene.prior)
    headings = sorted({yaw for yaw, _ in pairs})
    step = headings[1] - headings[0]
    assert step <= 1.5 / 30 + 1e-12
    assert headings[-1] + step / 2 == pytest.approx(3 * scene.prior.sigma_yaw_rad)
    assert 0.0 in headings
    everywhere = hypotheses(30.0, 1.0, replace(scene.prior, sigma_yaw_rad=5.0))
    assert max(yaw for yaw, _ in everywhere) < np.pi
    assert hypotheses(30.0, 1.0, replace(scene.prior, sigma_yaw_rad=0.0, sigma_scale=0.0)) == [(0.0, 1.0)]


def test_the_best_place_is_within_a_cell_of_the_right_one(scene):
    pair = make_pair(scene.source_m, scene.reference_m, scene.prior)
    places, _ = find_places(pair, scene.prior, 3)
    off = moved(places[0].T, pair.centre_m) - moved(scene.T_true, pair.centre_m)
    assert np.abs(off[:2]).max() < 1.5
    assert yaw_of(places[0].T) == pytest.approx(np.radians(2.5), abs=np.radians(1.6))
    assert [p.score for p in places] == sorted((p.score for p in places), reverse=True)


def test_a_gaussian_prior_takes_its_handicap_from_the_scores(scene):
    pair = make_pair(scene.source_m, scene.reference_m, scene.prior)
    uniform = replace(scene.prior, sigma_scale=0.0)
    prior = replace(uniform, gaussian=True)
    alike, nearer = (find_places(pair, p, 1)[0] for p in (uniform, prior))
    np.testing.assert_allclose(nearer[0].T, alike[0].T)
    assert nearer[0].score == pytest.approx(alike[0].score - of_similarity(nearer[0].T, pair.centre_m, prior), abs=1e-5)
    assert alike[0].score - nearer[0].score > 0.005


def test_a_template_turns_with_its_heading(scene):
    pair = make_pair(scene.source_m, scene.reference_m, scene.prior)
    upright = template(pair.source_relief, pair.centre_m, 0.0, 1.0, 1.0, 45)
    quarter = template(pair.source_relief, pair.centre_m, np.pi / 2, 1.0, 1.0, 45)
    turned = np.rot90(upright.height_m, -1)  # rows run north: a quarter to the left is one to the right of the array
    both = quarter.known & np.rot90(upright.known, -1)
    assert both.sum() > 2000
    np.testing.assert_allclose(quarter.height_m[both], turned[both], atol=1e-3)


def test_the_side_of_a_peak_is_no_rival(scene):
    pair = make_pair(scene.source_m, scene.reference_m, scene.prior)
    score = np.full((120, 120), NO_SCORE, np.float32)
    rows, cols = np.indices(score.shape)
    score[:] = 0.9 - 0.01 * np.hypot(rows - 60, cols - 60)
    score[20, 20] += 0.2
    here = pair.reference.corner_m + pair.reference.cell_m * np.array([60.5, 60.5])
    rival = runner_up(pair, Scores(score, np.zeros(score.shape, np.int32), (0, 0)), here)
    assert rival == pytest.approx(float(score[20, 20]))
    there = pair.reference.corner_m + pair.reference.cell_m * np.array([20.5, 20.5])
    nothing = runner_up(pair, Scores(score, np.zeros(score.shape, np.int32), (0, 0)), np.array([here, there]))
    assert nothing == 0, "no other peak"


def test_the_work_of_a_search_grows_with_hypotheses_and_region(scene):
    pair = make_pair(scene.source_m, scene.reference_m, scene.prior)
    once = work(pair, scene.prior)
    n = len(hypotheses(pair.half_m, pair.reference.cell_m, scene.prior))
    turned = replace(scene.prior, sigma_yaw_rad=3 * scene.prior.sigma_yaw_rad)
    assert work(pair, turned) == once * len(hypotheses(pair.half_m, pair.reference.cell_m, turned)) / n
    near, far = (work(pair, replace(scene.prior, sigma_horizontal_m=s)) for s in (0.5, 50.0))
    assert near < once < far
    assert far <= n * np.prod(np.array(pair.reference.known.shape) + 2 * pair.half_m * 2)


def test_a_search_that_would_take_too_long_is_declined(scene):
    pair = make_pair(scene.source_m, scene.reference_m, scene.prior)
    cost = work(pair, scene.prior)
    declined = HeightSearchRegistration(1.0, cost - 1)(scene.source_m, scene.reference_m, scene.prior)
    assert isinstance(declined, NotRegistered)
    assert declined.reason is Reason.SEARCH_TOO_WIDE
    assert isinstance(HeightSearchRegistration(1.0, cost)(scene.source_m, scene.reference_m, scene.prior), Registered)


@pytest.mark.parametrize("sigma_scale", [100.0, 1e9])
def test_a_scale_that_is_hardly_known_is_declined_before_its_ladder_is_made(scene, sigma_scale):
    """Three sigma of 100 overflowed, of a million filled the memory with hypotheses."""
    declined = make_registration("height-search")(
        scene.source_m, scene.reference_m, replace(scene.prior, sigma_scale=sigma_scale, sigma_yaw_rad=1e9)
    )
    assert isinstance(declined, NotRegistered)
    assert declined.reason is Reason.SEARCH_TOO_WIDE


@pytest.mark.parametrize("field", ["sigma_horizontal_m", "sigma_vertical_m", "sigma_yaw_rad", "sigma_scale", "sigma_growth_m"])
def test_a_prior_that_is_no_number_is_refused(scene, field):
    """One of NaN made a probability of NaN, which no limit declines."""
    for value in (math.nan, -1.0):
        with pytest.raises(ValueError, match="negative or not a number"):
            replace(scene.prior, **{field: value})


def test_a_thin_cloud_of_kilometres_is_declined_at_once():
    """A thousand points over 3 km x 4 km, as a file in feet without a CRS has them."""
    xy = np.random.default_rng(1).uniform(0, [3300, 4600], (1065, 2))
    points = np.column_stack([xy, 5 * np.sin(xy[:, 0] / 70)])
    prior = RegistrationPrior(5.0, 2.0, math.radians(3.0), math.radians(0.5), 0.01, 0.0)
    declined = make_registration("height-search")(points, points, prior)
    assert isinstance(declined, NotRegistered)
    assert declined.reason is Reason.SEARCH_TOO_WIDE


@pytest.mark.parametrize("gaussian", [False, True])
def test_a_place_of_which_nothing_is_known_is_looked_for_on_the_whole_reference(scene, gaussian):
    prior = replace(scene.prior, sigma_horizontal_m=math.inf, gaussian=gaussian)
    found = make_registration("height-search")(scene.source_m, scene.reference_m, prior)
    assert isinstance(found, Registered)
    assert np.abs(scene.offset_m(found.T_reference_source).mean(0)).max() < 0.3


def beside_the_edge(scene, east_m: float) -> np.ndarray:
    """The reference without what lies west of a line."""
    return scene.reference_m[scene.reference_m[:, 0] > east_m]


@pytest.mark.parametrize("gaussian", [False, True])
def test_a_place_whose_middle_lies_beyond_the_references_edge_is_found(scene, gaussian):
    """37 % of the source lies on it, and its middle 8 m off it: places like that were not looked at, and others were believed."""
    reference = beside_the_edge(scene, 25.0)
    found = make_registration("height-search")(scene.source_m, reference, replace(scene.prior, gaussian=gaussian))
    assert isinstance(found, Registered)
    assert np.abs(scene.offset_m(found.T_reference_source).mean(0)).max() < 0.3
    assert 0.5 < dict(found.evidence)["unseen"] < 0.8


@pytest.mark.parametrize("gaussian", [False, True])
def test_what_cannot_be_compared_is_counted_by_how_likely_the_prior_has_it(scene, gaussian):
    pair = make_pair(scene.source_m, scene.reference_m, scene.prior)

    def unseen(east_m: float, sigma_m: float) -> float:
        prior = replace(scene.prior, sigma_horizontal_m=sigma_m, gaussian=gaussian)
        cut = make_pair(scene.source_m, beside_the_edge(scene, pair.centre_m[0] + east_m), prior)
        return search(cut, [(0.0, 1.0)], prior).unseen

    assert unseen(-60.0, 5.0) == pytest.approx(0, abs=1e-6)
    assert unseen(15.0, 5.0) == pytest.approx(0.5, abs=0.07), "a quarter of the source lies on it at the prior's place"
    one_sigma = unseen(20.0, 5.0)
    assert one_sigma == pytest.approx(0.84 if gaussian else (1 + 1 / math.sqrt(3)) / 2, abs=0.05)
    assert one_sigma < unseen(25.0, 5.0) <= 1
    assert unseen(0.0, 1e9) > 0.999, "and no array of what lies between"
    assert unseen(29.0, 1e-3) == 1.0
