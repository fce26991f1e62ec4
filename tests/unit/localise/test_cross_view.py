"""A frame of unknown heading and lean, over the analytic map and with features that need no network."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.geo.se3 import euler_from_quat
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.localise import cross_view
from visloc_companion.localise.cross_view import CrossViewLocaliser
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.localise.verify import unknown_attitude_wrong
from visloc_companion.types import CameraModel, Fix, GeoPoint, LocaliseRequest, NoFix

HOME = GeoPoint(47.0, 8.0, 0.0)
MODEL = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)
TRUTH, ATTITUDE = (25.0, -18.0, -240.0), (0.22, -0.12, 1.3)
SETTINGS = LocaliserSettings(max_probability_wrong=1.0)


def asked(support) -> LocaliseRequest:
    """Level, 40 degrees off in heading and 31 m in place."""
    told = support.request_at((0.0, 0.0, -243.0), (0.0, 0.0, 0.6), 18.0, 5.0, 25.0)
    return replace(told, prior=replace(told.prior, sigma_tilt_rad=math.radians(6.0)))


@pytest.fixture(scope="module")
def answer(flat, support) -> Fix | NoFix:
    frame = support.render(flat, MODEL, TRUTH, ATTITUDE)
    return CrossViewLocaliser(MODEL, SETTINGS, GRADIENT).localise(asked(support), frame, flat)


def off_m(answer: Fix) -> float:
    return math.hypot(*(np.array(ned_from_geo(answer.place, HOME)[:2]) - TRUTH[:2]))


def test_place_heading_and_lean_are_found(answer):
    assert isinstance(answer, Fix), answer
    assert answer.method == "cross-view"
    assert off_m(answer) < 6.0, "what is not known of the lean moves the camera, 140 m above the ground"
    offset = np.array(ned_from_geo(answer.place, HOME)[:2]) - TRUTH[:2]
    assert offset @ np.linalg.solve(np.array(answer.cov_ne_m2), offset) < 9.21, "99 % of two degrees of freedom"
    assert euler_from_quat(answer.q_ned_frd) == pytest.approx(ATTITUDE, abs=0.05)
    assert abs(answer.place.h_amsl_m - 240.0) < 2.0
    assert answer.tilt is None, "a guess is no attitude that anybody flew by"


def test_the_candidates_of_the_search_are_told(answer):
    evidence = dict(answer.evidence)
    assert evidence["leans"] == 7
    first = np.array([evidence["patch1_north_m"], evidence["patch1_east_m"]])
    assert np.linalg.norm(first - TRUTH[:2]) < 40.0
    outs = [evidence[f"patch{k}_stands_out"] for k in range(1, 4)]
    assert outs == sorted(outs, reverse=True) and outs[-1] > 0


@pytest.fixture
def from_above(support) -> LocaliseRequest:
    """A prior that leaves one lean to be searched."""
    return support.request_at((20.0, -14.0, -240.0), (0.0, 0.0, 1.3))


def test_an_answer_that_the_prior_rules_out_is_declined(flat, support, from_above, monkeypatch):
    frame = support.render(flat, MODEL, TRUTH, (0.0, 0.0, 1.32))
    found = CrossViewLocaliser(MODEL, SETTINGS, GRADIENT).localise(from_above, frame, flat)
    assert isinstance(found, Fix) and off_m(found) < 3.0
    monkeypatch.setattr(cross_view, "MAX_CHI2_SIGMA", 0.3)
    said = CrossViewLocaliser(MODEL, SETTINGS, GRADIENT).localise(from_above, frame, flat)
    assert isinstance(said, NoFix) and said.reason is Reason.INCONSISTENT_WITH_PRIOR


def test_a_frame_of_another_place_is_declined(flat, support, from_above):
    elsewhere = replace(flat, pixels=support.texture(9))
    frame = support.render(elsewhere, MODEL, TRUTH, (0.0, 0.0, 1.32))
    said = CrossViewLocaliser(MODEL, LocaliserSettings(), GRADIENT).localise(from_above, frame, flat)
    assert isinstance(said, NoFix) and said.method == "cross-view"
    assert dict(said.evidence)["p_wrong"] > 0.2


def test_a_black_frame_and_a_place_off_the_map_say_so(flat, support):
    localiser = CrossViewLocaliser(MODEL, SETTINGS, GRADIENT)
    black = localiser.localise(asked(support), np.zeros((120, 160), np.uint8), flat)
    assert isinstance(black, NoFix) and black.reason is Reason.TOO_DARK
    far = support.request_at((9000.0, 0.0, -240.0), (0.0, 0.0, 0.6))
    frame = support.render(flat, MODEL, TRUTH, ATTITUDE)
    outside = localiser.localise(far, frame, flat)
    assert isinstance(outside, NoFix) and outside.reason is Reason.OUTSIDE_MAP


def test_a_horizon_in_view_under_every_lean_says_so(flat, support):
    told = support.request_at((0.0, 0.0, -240.0), (0.0, math.radians(85.0), 0.6))
    said = CrossViewLocaliser(MODEL, SETTINGS, GRADIENT).localise(told, support.render(flat, MODEL, TRUTH, ATTITUDE), flat)
    assert isinstance(said, NoFix) and said.reason is Reason.HORIZON_IN_VIEW


def test_what_resembles_the_map_more_is_less_likely_wrong():
    numbers = {"score": 0.3, "ahead": 0.1, "blocks": 40.0, "blocks_agreeing": 12.0, "scatter_px": 1.5, "sigma_px": 3.0}
    p = unknown_attitude_wrong(numbers)
    assert 0 < p < 1
    assert unknown_attitude_wrong(numbers | {"ahead": 0.3, "score": 0.5, "blocks_agreeing": 30.0}) < p
    assert unknown_attitude_wrong(numbers | {"ahead": 0.0, "score": 0.1, "blocks_agreeing": 4.0}) > p
