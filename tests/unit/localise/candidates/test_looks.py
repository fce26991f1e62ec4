"""A frame that gradients decline is looked at again through the features that found it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.localise.candidates.looks import Look, convincing, surer, with_quarters
from visloc_companion.localise.candidates.ranking import GRADIENT_RANK
from visloc_companion.localise.dense import DenseLocaliser, Fitted
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.settings import LocaliserSettings, Looks
from visloc_companion.localise.verify import GRADIENT_WEIGHTS, Evidence, probability_wrong
from visloc_companion.types import CameraModel, Fix, GeoPoint, NoFix

HOME = GeoPoint(47.0, 8.0, 0.0)
MODEL = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)
TRUTH, LEVEL = (23.0, -41.0, -335.0), (0.0, 0.0, 0.6)


@dataclass
class Broad:
    """Gradients of what is broad; counts how often they are made."""

    name: str = "broad"
    recipe: str = "blurred by 4 px"
    channels: int = GRADIENT.channels
    oriented: int = GRADIENT.oriented
    bound: float = GRADIENT.bound
    context_px: int = GRADIENT.context_px + 20
    tolerance: tuple[float, float] | None = None
    calls: int = 0

    def __call__(self, image, valid):
        self.calls += 1
        return GRADIENT(cv2.GaussianBlur(image, (0, 0), 4), valid)


def woods(support, seed):
    """The same stands of trees; their crowns are others with each seed."""
    stands = cv2.GaussianBlur(support.texture(1, 700), (0, 0), 4).astype(np.float32)
    crowns = cv2.GaussianBlur(np.random.default_rng(seed).standard_normal(stands.shape).astype(np.float32), (0, 0), 2)
    pixels = np.clip(128 + stands - stands.mean() + 35 * crowns / crowns.std(), 0, 255).astype(np.uint8)
    return support.FlatMap(pixels, np.full(pixels.shape, 100.0, np.float32))


@pytest.fixture(scope="module")
def map_and_frames(support):
    known, grown = woods(support, 1), woods(support, 2)
    return known, support.render(known, MODEL, TRUTH, LEVEL), support.render(grown, MODEL, TRUTH, LEVEL)


def answer_of(features, looks, frame, known, support, limit=0.05):
    fitted = Fitted(GRADIENT_WEIGHTS, GRADIENT_RANK, 1.04, GRADIENT_WEIGHTS)
    settings = LocaliserSettings(max_probability_wrong=limit, looks=looks)
    request = support.request_at((19.0, -37.0, -333.0), LEVEL, sigma_m=6.0)
    return DenseLocaliser("deep", MODEL, settings, features, fitted).localise(request, frame, known)


def test_what_gradients_decline_is_looked_at_again(map_and_frames, support):
    known, _, grown = map_and_frames
    first = answer_of(Broad(), Looks.FIRST, grown, known, support)
    assert isinstance(first, NoFix)
    both = answer_of(Broad(), Looks.BOTH, grown, known, support)
    assert isinstance(both, Fix)
    north, east, _ = ned_from_geo(both.place, HOME)
    assert np.hypot(north - TRUTH[0], east - TRUTH[1]) < 4.0
    assert dict(both.evidence)["looks"] == 2.0
    second = answer_of(Broad(), Looks.SECOND, grown, known, support)
    assert isinstance(second, Fix)
    assert second.place == both.place


def test_what_they_accept_is_not(map_and_frames, support):
    known, same, _ = map_and_frames
    once, twice = Broad(), Broad()
    first = answer_of(once, Looks.FIRST, same, known, support)
    both = answer_of(twice, Looks.BOTH, same, known, support)
    assert isinstance(first, Fix)
    assert isinstance(both, Fix)
    assert (both.place, both.cov_ne_m2, twice.calls) == (first.place, first.cov_ne_m2, once.calls)
    assert dict(both.evidence)["looks"] == 1.0


def test_what_is_declined_is_asked_for_its_quarters_where_the_prior_leaves_many_places(map_and_frames, support):
    known, same, grown = map_and_frames
    fitted = Fitted(GRADIENT_WEIGHTS, GRADIENT_RANK, 1.04, GRADIENT_WEIGHTS)
    settings = LocaliserSettings(looks=Looks.FIRST)
    deep = DenseLocaliser("deep", MODEL, settings, Broad(), fitted)
    gradient = DenseLocaliser("gradient", MODEL, settings, Broad(), Fitted(GRADIENT_WEIGHTS, GRADIENT_RANK, 1.04))

    def quarters(localiser, frame, sigma_m, tilt_deg=0.5):
        request = support.request_at((19.0, -37.0, -333.0), LEVEL, sigma_m=sigma_m)
        request = replace(request, prior=replace(request.prior, sigma_tilt_rad=np.radians(tilt_deg)))
        return dict(localiser.localise(request, frame, known).evidence).get("quarters")

    doubted = cv2.addWeighted(same, 0.15, grown, 0.85, 0)
    assert quarters(deep, doubted, 40.0) > 3.0
    assert quarters(deep, same, 40.0) is None  # it is not declined
    assert quarters(deep, doubted, 3.0) is None
    assert quarters(deep, doubted, 40.0, tilt_deg=6.0) is None
    assert quarters(gradient, doubted, 40.0) is None


@pytest.mark.parametrize(("lean_deg", "tilt_deg", "looks"), [(20.0, 1.0, 2.0), (40.0, 1.0, 1.0), (40.0, 0.5, 2.0)])
def test_from_the_side_only_where_the_tilt_is_known(map_and_frames, support, lean_deg, tilt_deg, looks):
    known, *_ = map_and_frames
    attitude = (0.0, np.radians(lean_deg), 0.6)
    seen = support.render(woods(support, 2), MODEL, TRUTH, attitude)
    request = support.request_at((19.0, -37.0, -333.0), attitude, sigma_m=6.0)
    request = replace(request, prior=replace(request.prior, sigma_tilt_rad=np.radians(tilt_deg)))
    settings = LocaliserSettings(max_probability_wrong=0.0, looks=Looks.BOTH)
    fitted = Fitted(GRADIENT_WEIGHTS, GRADIENT_RANK, 1.04, GRADIENT_WEIGHTS)
    answer = DenseLocaliser("deep", MODEL, settings, Broad(), fitted).localise(request, seen, known)
    assert dict(answer.evidence)["looks"] == looks


def test_a_limit_changes_which_answers_are_given_but_none_of_them(map_and_frames, support):
    known, _, grown = map_and_frames
    strict, lenient = (answer_of(Broad(), Looks.BOTH, grown, known, support, limit) for limit in (1e-9, 1.0))
    assert isinstance(strict, NoFix)
    assert isinstance(lenient, Fix)
    assert dict(strict.evidence)["p_wrong"] == dict(lenient.evidence)["p_wrong"]


GOOD = Evidence(0.6, 0.6, 0.5, 6.0, 0.9, 36.0, 30.0, 170.0, 0.8, 0.5, 0.5, 0.5, 0.5, 0.7, 0.4)
NOTHING = (Reason.NO_MATCH, "no likeness within the search region")


def look(p: float, position_sigmas: float = 0.5, votes: float = 1.0) -> Look:
    nothing: Any = None
    evidence = replace(GOOD, position_sigmas=position_sigmas)
    return Look(nothing, (), nothing, nothing, evidence, nothing, 1.0, votes, p, 1 - (1 - p) * votes)


def test_the_surer_look_decides():
    good, doubtful, worse = look(0.01), look(0.2), look(0.3)
    assert surer(worse, good, 0.05) is good
    assert surer(worse, doubtful, 0.05) is doubtful
    assert surer(doubtful, worse, 0.05) is doubtful
    assert surer(worse, look(0.3), 0.05) is worse
    assert surer(NOTHING, worse, 0.05) is worse
    assert surer(worse, NOTHING, 0.05) is worse
    assert surer(NOTHING, (Reason.POSE_FAILED, "no pose"), 0.05) is NOTHING


def test_one_that_contradicts_the_prior_is_declined_however_sure_it_is():
    far, good = look(0.001, position_sigmas=5.0), look(0.04)
    assert far.why_not(0.05) == (Reason.INCONSISTENT_WITH_PRIOR, "5.0 sigma from the prior")
    assert surer(far, good, 0.05) is good
    assert surer(good, far, 0.05) is good


def test_one_that_its_blocks_do_not_confirm_is_declined_however_sure_it_is():
    outvoted, good = look(0.001, votes=0.6), look(0.04)
    why = outvoted.why_not(0.05)
    assert why is not None
    assert why[0] is Reason.BLOCKS_DISAGREE
    assert surer(outvoted, good, 0.05) is good
    assert look(0.001, votes=0.98).why_not(0.05) is None


def test_one_that_only_its_prior_makes_sure_does_not_do_without_another_look():
    poor = replace(GOOD, score=0.2, coarse_score=0.3, runner_up=0.9, agreeing=6.0, lead=1.5, prior_px=0.6)
    alone = probability_wrong(poor, GRADIENT_WEIGHTS)
    seen = replace(look(alone), evidence=poor)
    assert seen.why_not(0.005) is None
    assert not convincing(seen, GRADIENT_WEIGHTS, 0.005)
    assert convincing(replace(seen, evidence=replace(GOOD, prior_px=0.6)), GRADIENT_WEIGHTS, 0.005)
    assert not convincing(NOTHING, GRADIENT_WEIGHTS, 0.005)
    assert not convincing(None, GRADIENT_WEIGHTS, 0.005)


def test_where_blocks_hardly_agree_or_few_places_are_left_quarters_are_not_asked():
    nothing: Any = None
    for evidence in (replace(GOOD, agreeing=5.0), replace(GOOD, prior_px=1.0)):
        seen = replace(look(0.2), evidence=evidence)
        assert with_quarters(seen, nothing, GRADIENT_WEIGHTS) is seen


def test_quarters_convince_of_a_poor_look_or_speak_against_it():
    poor = replace(GOOD, score=0.2, coarse_score=0.3, runner_up=0.9, agreeing=6.0, lead=1.5)
    seen = replace(look(probability_wrong(poor, GRADIENT_WEIGHTS)), evidence=poor)
    assert not convincing(seen, GRADIENT_WEIGHTS, 0.005)
    assert convincing(replace(seen, quarters=10.0), GRADIENT_WEIGHTS, 0.005)
    assert convincing(seen, GRADIENT_WEIGHTS, 0.05)
    assert not convincing(replace(seen, quarters=-5.0), GRADIENT_WEIGHTS, 0.05)
    assert not convincing(replace(seen, quarters=20.0, votes=0.9), GRADIENT_WEIGHTS, 0.05)


@pytest.mark.parametrize("doubt", [{"share": 0.5}, {"votes": 0.5}, {"share": 0.7, "votes": 0.7}])
def test_quarters_are_heard_instead_of_shares_where_many_blocks_agree(doubt):
    seen, few = replace(look(0.02), **doubt), replace(GOOD, agreeing=7.0)
    assert not convincing(seen, GRADIENT_WEIGHTS, 0.05)
    assert convincing(replace(seen, quarters=6.0), GRADIENT_WEIGHTS, 0.05)
    assert not convincing(replace(seen, quarters=-2.0), GRADIENT_WEIGHTS, 0.05)
    assert convincing(replace(look(0.02), evidence=few, quarters=6.0), GRADIENT_WEIGHTS, 0.05)
    assert not convincing(replace(seen, evidence=few, quarters=6.0), GRADIENT_WEIGHTS, 0.05)


def test_a_place_that_quarters_call_the_only_one_is_not_declined_for_others():
    asked = replace(look(0.02), share=0.5, quarters=6.0)
    assert asked.why_not(0.05) is None
    assert replace(asked, quarters=-2.0).why_not(0.05) == (Reason.AMBIGUOUS, "one of several places, 50 % for the others")


def test_a_frame_that_could_be_of_many_places_is_of_the_one_where_the_vehicle_is(map_and_frames, support):
    """Known to 3 m it was declined as it is where it might be 40 m away; beside a prior that is wrong nothing is taken for it."""
    known, same, grown = map_and_frames
    frame = cv2.addWeighted(same, 0.15, grown, 0.85, 0)
    localiser = DenseLocaliser("gradient", MODEL, LocaliserSettings(), Broad(), Fitted(GRADIENT_WEIGHTS, GRADIENT_RANK, 1.04))

    def asked(at: tuple[float, float, float], sigma_m: float) -> Fix | NoFix:
        return localiser.localise(support.request_at(at, LEVEL, sigma_m=sigma_m), frame, known)

    fix = asked((21.0, -40.0, -333.0), 3.0)
    assert isinstance(fix, Fix)
    north, east, _ = ned_from_geo(fix.place, HOME)
    assert np.hypot(north - TRUTH[0], east - TRUTH[1]) < 6.0
    unknown = asked((21.0, -40.0, -333.0), 40.0)
    assert isinstance(unknown, NoFix)
    assert dict(unknown.evidence)["p_wrong"] > 0.1
    for beside in ((61.0, -40.0, -333.0), (21.0, 10.0, -333.0), (-30.0, -80.0, -333.0)):
        assert isinstance(asked(beside, 3.0), NoFix)
