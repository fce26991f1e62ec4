from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.localise.candidates.hypotheses import hypotheses, search_box
from visloc_companion.localise.features.gradient import eroded
from visloc_companion.localise.frame import full_level
from visloc_companion.localise.joint_histogram import bin_edges, labelled, mutual_information, search_histograms
from visloc_companion.localise.mapped.window import map_grid
from visloc_companion.localise.mutual_information import MutualInformationLocaliser
from visloc_companion.localise.ortho_rectify import CameraPose, rectify_plane
from visloc_companion.localise.plan import SearchPlan, make_plan, turned
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.localise.template import GREY
from visloc_companion.types import CameraModel, Fix, GeoPoint, NoFix

HOME = GeoPoint(47.0, 8.0, 0.0)
MODEL = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)
LEVEL = (0.0, 0.0, 0.6)


def test_bins_share_the_valid_values_evenly_and_round():
    values = np.arange(160, dtype=np.float32).reshape(10, 16)
    valid = values < 80
    labels = labelled(values, bin_edges(values, valid, 8))
    assert np.bincount(labels[valid], minlength=8).tolist() == [10] * 8
    assert labels[~valid].min() == 7
    assert (labelled(values, bin_edges(values, np.zeros_like(valid), 8)) <= 7).all()


def test_mutual_information_is_one_for_a_relabelling_and_zero_for_no_relation():
    rng = np.random.default_rng(1)
    a = rng.integers(0, 8, (200, 200)).astype(np.uint8)
    everywhere = np.ones(a.shape, np.bool_)
    assert mutual_information(a, (7 - a).astype(np.uint8), everywhere, 8) == pytest.approx(1.0)
    assert mutual_information(a, rng.permutation(a.ravel()).reshape(a.shape), everywhere, 8) < 0.002
    assert mutual_information(a, a, ~everywhere, 8) == 0.0
    assert mutual_information(np.zeros_like(a), np.zeros_like(a), everywhere, 8) == 0.0


def test_mutual_information_agrees_with_its_definition():
    a, b = np.array([[0, 0, 1, 1]], np.uint8), np.array([[0, 1, 1, 1]], np.uint8)
    joint = np.array([0.25, 0.25, 0.5])
    entropy = [-(p * np.log(p)).sum() for p in (np.array([0.5, 0.5]), np.array([0.25, 0.75]), joint)]
    expected = (entropy[0] + entropy[1]) / entropy[2] - 1
    assert mutual_information(a, b, np.ones((1, 4), np.bool_), 2) == pytest.approx(expected)


def test_transforms_give_the_same_scores_as_counting(flat, support):
    """The exhaustive search against the histogram counted pixel by pixel at some of its places."""
    prior = support.request_at((0.0, 0.0, -240.0), LEVEL, sigma_m=4.0, sigma_h_m=1.0, sigma_yaw_deg=0.5)
    plan = make_plan(prior.prior, MODEL, flat, LocaliserSettings())
    assert isinstance(plan, SearchPlan)
    grid = map_grid(flat, plan.frame, *search_box(plan), plan.coarse_gsd_m, GREY)
    level = full_level(support.render(flat, MODEL, (2.0, -3.0, -240.0), LEVEL), MODEL)
    volume = search_histograms(grid, level, plan, 4)
    there = labelled(grid.features[..., 0], bin_edges(grid.features[..., 0], grid.weight > 0, 4))
    for row, col in ((0, 0), (3, 5), tuple(s // 2 for s in volume.score.shape), tuple(s - 1 for s in volume.score.shape)):
        u, v = volume.origin_px[0] + col, volume.origin_px[1] + row
        heading, scale = hypotheses(plan)[int(volume.hypothesis[row, col])]
        at = grid.A_ne_pix @ np.array([u, v, 1.0])
        pose = CameraPose(np.array([*at, -plan.ground_up_m - plan.agl_m * scale]), turned(plan.pose.R_ned_cam, heading))
        image, shown = rectify_plane(level, pose, grid.A_ne_pix, grid.weight.shape[::-1], plan.ground_up_m)
        seen = eroded(shown, 3) > 0
        mine = labelled(image, bin_edges(image, seen, 4))
        counted = mutual_information(mine, there, seen & (grid.weight > 0), 4)
        assert float(volume.score[row, col]) == pytest.approx(counted, abs=0.01)


def test_inverted_grey_values_are_no_obstacle(flat, support):
    """What mutual information has over correlation: any one-to-one relation of the grey values will do."""
    truth = (5.0, 8.0, -240.0)
    frame = (255 - support.render(flat, MODEL, truth, LEVEL)).astype(np.uint8)
    answer = MutualInformationLocaliser(MODEL, LocaliserSettings()).localise(
        support.request_at((0.0, 0.0, -238.0), LEVEL), frame, flat
    )
    assert isinstance(answer, Fix)
    north, east, down = ned_from_geo(answer.place, HOME)
    assert math.hypot(north - truth[0], east - truth[1]) < 0.6
    assert abs(down - truth[2]) < 1.0


def test_frame_of_another_place_is_declined(flat, support):
    pixels = support.texture(103)
    other = support.FlatMap(pixels, np.full(pixels.shape, 100.0, np.float32))
    frame = support.render(other, MODEL, (0.0, 0.0, -240.0), LEVEL)
    answer = MutualInformationLocaliser(MODEL, LocaliserSettings()).localise(
        support.request_at((0.0, 0.0, -240.0), LEVEL), frame, flat
    )
    assert isinstance(answer, NoFix)
    assert answer.reason in {Reason.NO_MATCH, Reason.AMBIGUOUS}
