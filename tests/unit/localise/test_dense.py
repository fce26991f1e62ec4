from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from visloc_companion.errors import ConfigError, Reason
from visloc_companion.geo.se3 import euler_from_quat
from visloc_companion.geo.wgs84 import distance_m, ned_from_geo
from visloc_companion.localise.dense import gradient_localiser
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.registry import METHODS, make_localiser
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.protocols import Localiser
from visloc_companion.types import CameraModel, Fix, GeoPoint, Image, NoFix

HOME, GROUND_M = GeoPoint(47.0, 8.0, 0.0), 100.0
MODEL = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)
LEVEL = (0.0, 0.0, 0.6)


def error_m(answer: Fix | NoFix, p_ned_m: tuple[float, float, float]) -> tuple[float, float]:
    assert isinstance(answer, Fix), answer
    north, east, down = ned_from_geo(answer.place, HOME)
    return math.hypot(north - p_ned_m[0], east - p_ned_m[1]), abs(down - p_ned_m[2])


@pytest.mark.parametrize(
    ("world", "euler"),
    [("flat", LEVEL), ("hilly", LEVEL), ("flat", (0.3, -0.2, 2.5)), ("hilly", (-0.1, 0.6, -1.0))],
)
def test_pose_of_a_frame_is_found_to_a_fraction_of_a_pixel(world, euler, support, request):
    ref = request.getfixturevalue(world)
    truth = (23.0, -41.0, -235.0)
    frame = support.render(ref, MODEL, truth, euler)
    prior = support.request_at((12.0, -29.0, -232.0), (euler[0], euler[1], euler[2] + 0.05))
    answer = gradient_localiser(MODEL, LocaliserSettings()).localise(prior, frame, ref)
    horizontal, vertical = error_m(answer, truth)
    assert horizontal < 0.35
    assert vertical < 0.7
    assert isinstance(answer, Fix)
    assert abs(euler_from_quat(answer.q_ned_frd)[2] - euler[2]) < 0.01
    assert answer.probability_wrong < 0.01
    assert (answer.request_id, answer.frame_id, answer.t_ns, answer.method) == (7, 3, 2, "gradient")


@pytest.mark.parametrize("beside_m", [0.0, 150.0])
def test_how_high_the_camera_is_tells_the_ground_where_it_was_found(beside_m: float, flat, support):
    """Not that where the prior thought it was: 60 m higher up this slope."""
    up = 100 + 0.4 * (np.arange(500, dtype=np.float32)[None, :] - 250) + np.zeros((500, 1), np.float32)
    slope, truth = support.FlatMap(flat.pixels, up), (-20.0, 90.0 - beside_m, -300.0)
    prior = support.request_at((0.0, 90.0, -300.0), LEVEL, sigma_m=70.0)
    answer = gradient_localiser(MODEL, LocaliserSettings()).localise(prior, support.render(slope, MODEL, truth, LEVEL), slope)
    assert error_m(answer, truth)[0] < 1.0
    assert answer.above_ground_m == pytest.approx(300.0 - slope.height_amsl_m(truth[1], truth[0]), abs=3.0)


def test_a_frame_about_a_gap_of_the_map_is_found_on_what_lies_around_it(support):
    """The sun over the map was looked for in the gap, and what was found given up for that."""
    pixels, known = support.texture(1, 900), np.ones((900, 900), np.bool_)
    known[386 - 140 : 386 + 140, 514 - 140 : 514 + 140] = False  # with margin, the tile that the camera's axis meets
    whole = support.FlatMap(pixels, (100 + 12 * np.sin(np.arange(900) / 40)[:, None] * np.ones(900)).astype(np.float32))
    model, truth = CameraModel(320, 240, 185.0, 185.0, 159.5, 119.5), (66.0, 61.0, -450.0)
    gap = support.FlatMap(whole.pixels, whole.surface, known=known)
    prior = support.request_at((64.0, 64.0, -450.0), LEVEL, model=model)
    answer = gradient_localiser(model, LocaliserSettings()).localise(prior, support.render(whole, model, truth, LEVEL), gap)
    assert error_m(answer, truth)[0] < 0.5


def test_lens_distortion_is_undone(flat, support):
    model = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5, (-0.15, 0.03, 0.001, -0.001, 0.0))
    truth = (5.0, 8.0, -240.0)
    answer = gradient_localiser(model, LocaliserSettings()).localise(
        support.request_at((0.0, 0.0, -240.0), LEVEL), support.render(flat, model, truth, LEVEL), flat
    )
    assert error_m(answer, truth)[0] < 0.35


def test_same_request_gives_the_same_answer(flat, support):
    frame = support.render(flat, MODEL, (5.0, 8.0, -240.0), LEVEL)
    localiser = gradient_localiser(MODEL, LocaliserSettings())
    a, b = (localiser.localise(support.request_at((0.0, 0.0, -240.0), LEVEL), frame, flat) for _ in range(2))
    assert isinstance(a, Fix)
    assert isinstance(b, Fix)
    assert distance_m(a.place, b.place) < 1e-5
    assert a.place.h_amsl_m == pytest.approx(b.place.h_amsl_m, abs=1e-5)
    assert a.probability_wrong == pytest.approx(b.probability_wrong, rel=1e-4)


@pytest.mark.parametrize("method", ["gradient", "iclk"])
def test_a_pose_that_is_known_exactly_is_one_as_any_other(method, flat, support):
    truth = (5.0, 8.0, -240.0)
    frame = support.render(flat, MODEL, truth, LEVEL)
    localiser = make_localiser(method, MODEL, features=GRADIENT, max_probability_wrong=1.0)
    request = support.request_at((4.0, 8.0, -240.0), LEVEL)
    exact = replace(request.prior, sigma_tilt_rad=0.0)
    assert error_m(localiser.localise(replace(request, prior=exact), frame, flat), truth)[0] < 0.35
    all_exact = replace(exact, cov_ne_m2=((0.0, 0.0), (0.0, 0.0)), sigma_h_m=0.0, sigma_yaw_rad=0.0)
    assert isinstance(localiser.localise(replace(request, prior=all_exact), frame, flat), Fix | NoFix)


def test_map_sigma_enters_the_claimed_covariance(flat, support):
    frame = support.render(flat, MODEL, (5.0, 8.0, -240.0), LEVEL)
    request = support.request_at((0.0, 0.0, -240.0), LEVEL)
    bare, padded = (
        gradient_localiser(MODEL, LocaliserSettings(map_sigma_m=s)).localise(request, frame, flat) for s in (0.0, 2.0)
    )
    assert isinstance(bare, Fix)
    assert isinstance(padded, Fix)
    assert padded.cov_ne_m2[0][0] - bare.cov_ne_m2[0][0] == pytest.approx(4.0)


def noise(low: float, high: float) -> Image:
    return np.random.default_rng(1).uniform(low, high, (120, 160)).astype(np.uint8)


@pytest.mark.parametrize(
    ("frame", "reason"),
    [
        (np.zeros((120, 160), np.uint8), Reason.TOO_DARK),
        (noise(236, 246), Reason.OVEREXPOSED),
        (np.full((120, 160, 3), 90, np.uint8), Reason.LOW_TEXTURE),
        (noise(0, 255), Reason.LOW_TEXTURE),
        (noise(0, 40), Reason.TOO_DARK),
        (np.zeros((100, 160), np.uint8), Reason.BAD_FRAME),
        (np.zeros((120, 160, 4), np.uint8), Reason.BAD_FRAME),
        (np.zeros((120, 160), np.float32), Reason.BAD_FRAME),
        (np.zeros(5, np.uint8), Reason.BAD_FRAME),
        (np.zeros((0, 0), np.uint8), Reason.BAD_FRAME),
    ],
)
@pytest.mark.parametrize("method", METHODS)
def test_frames_that_show_nothing_are_declined(frame, reason, method, flat, support):
    answer = make_localiser(method, MODEL, features=GRADIENT).localise(support.request_at((0.0, 0.0, -240.0), LEVEL), frame, flat)
    assert isinstance(answer, NoFix)
    assert answer.reason is reason
    assert answer.method == method


@pytest.mark.parametrize(("width_px", "height_px"), [(1, 1), (5, 3), (31, 400)])
def test_a_thumbnail_is_no_frame(width_px: int, height_px: int, flat, support):
    model = CameraModel(width_px, height_px, 100.0, 100.0, width_px / 2, height_px / 2)
    frame = noise(0, 255)[:1, :1].repeat(height_px, 0).repeat(width_px, 1)
    answer = gradient_localiser(model, LocaliserSettings()).localise(support.request_at((0.0, 0.0, -240.0), LEVEL), frame, flat)
    assert isinstance(answer, NoFix)
    assert answer.reason is Reason.BAD_FRAME
    assert f"{width_px} x {height_px} pixels" in answer.detail


@pytest.mark.parametrize(
    ("p", "euler", "reason"),
    [
        ((9000.0, 0.0, -240.0), LEVEL, Reason.OUTSIDE_MAP),
        ((0.0, 0.0, -104.0), LEVEL, Reason.TOO_LOW),
        ((0.0, 0.0, -90.0), LEVEL, Reason.TOO_LOW),
        ((0.0, 0.0, -240.0), (0.0, 1.5, 0.0), Reason.HORIZON_IN_VIEW),
        ((0.0, 0.0, -240.0), (3.1, 0.0, 0.0), Reason.HORIZON_IN_VIEW),
    ],
)
@pytest.mark.parametrize("method", METHODS)
def test_poses_that_cannot_see_the_map_are_declined(p, euler, reason, method, flat, support):
    frame = support.render(flat, MODEL, (0.0, 0.0, -240.0), LEVEL)
    answer = make_localiser(method, MODEL, features=GRADIENT).localise(support.request_at(p, euler), frame, flat)
    assert isinstance(answer, NoFix)
    assert answer.reason is reason


@pytest.mark.parametrize("method", METHODS)
def test_a_place_without_coordinates_in_the_maps_crs_is_outside_the_map(method, elsewhere, flat, support):
    frame = support.render(flat, MODEL, (0.0, 0.0, -240.0), LEVEL)
    request = support.request_at((0.0, 0.0, -240.0), LEVEL)
    answer = make_localiser(method, MODEL, features=GRADIENT).localise(request, frame, elsewhere)
    assert isinstance(answer, NoFix)
    assert (answer.reason, answer.detail) == (Reason.OUTSIDE_MAP, "no coordinates in UTM zone 32N")


@pytest.mark.parametrize("seed", range(6))
def test_frames_of_another_place_or_of_noise_are_declined(seed, flat, support):
    if seed % 2:
        coarse = np.random.default_rng(seed).uniform(0, 255, (30, 40)).astype(np.uint8)
        frame = cv2.resize(coarse, (160, 120), interpolation=cv2.INTER_CUBIC)
    else:
        pixels = support.texture(100 + seed)
        other = support.FlatMap(pixels, np.full(pixels.shape, 100.0, np.float32))
        frame = support.render(other, MODEL, (0.0, 0.0, -240.0), LEVEL)
    answer = gradient_localiser(MODEL, LocaliserSettings()).localise(support.request_at((0.0, 0.0, -240.0), LEVEL), frame, flat)
    assert isinstance(answer, NoFix)
    assert answer.reason in {Reason.NO_MATCH, Reason.AMBIGUOUS, Reason.BLOCKS_DISAGREE, Reason.INCONSISTENT_WITH_PRIOR}


def test_tiny_overlap_of_frame_and_map_never_raises(flat, support):
    """Blocks without any overlap once reached OpenCV as empty arrays."""
    frame = support.render(flat, MODEL, (0.0, 0.0, -240.0), LEVEL)
    for north in (200.0, 250.0, 290.0):
        answer = gradient_localiser(MODEL, LocaliserSettings(max_probability_wrong=1.0)).localise(
            support.request_at((north, north, -240.0), LEVEL, sigma_m=5.0), frame, flat
        )
        assert isinstance(answer, Fix | NoFix)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_finds_an_easy_frame_and_keeps_the_protocol(method, flat, support):
    localiser = make_localiser(method, MODEL, features=GRADIENT, map_sigma_m=0.3)
    assert isinstance(localiser, Localiser)
    truth = (5.0, 8.0, -240.0)
    frame = support.render(flat, MODEL, truth, LEVEL)
    answer = localiser.localise(support.request_at((0.0, 0.0, -238.0), LEVEL), frame, flat)
    horizontal, vertical = error_m(answer, truth)
    assert horizontal < (1.5 if method == "ncc" else 0.6)
    assert vertical < 6.0
    assert answer.above_ground_m == pytest.approx(answer.place.h_amsl_m - GROUND_M, abs=0.1)
    assert answer.footprint_m == pytest.approx(answer.above_ground_m * math.sqrt(160 * 120) / 140.0, rel=0.03)


def test_unknown_method_is_named():
    with pytest.raises(ConfigError, match="telepathy"):
        make_localiser("telepathy", MODEL)


@pytest.mark.parametrize(("radius_m", "side_px", "left_out"), [(2000.0, 4000, 0.0), (120.0, 4000, 0.36), (2000.0, 180, 0.18)])
def test_a_search_that_leaves_out_some_of_the_prior_says_so(radius_m, side_px, left_out, flat, support, monkeypatch):
    """A window of the map has a largest side, and a search a largest radius: beyond them a place was left out without a word."""
    monkeypatch.setattr("visloc_companion.localise.mapped.window.MAX_SIDE_PX", side_px)
    monkeypatch.setattr("visloc_companion.localise.candidates.matching.MAX_SIDE_PX", side_px)
    truth = (5.0, 8.0, -240.0)
    frame = support.render(flat, MODEL, truth, LEVEL)
    request = support.request_at((0.0, 0.0, -240.0), LEVEL, sigma_m=85.0)
    told = []
    for limit in (1.0, 0.0):
        settings = LocaliserSettings(max_search_radius_m=radius_m, max_probability_wrong=limit)
        told.append(gradient_localiser(MODEL, settings).localise(request, frame, flat))
    taken, refused = told
    assert isinstance(taken, Fix)
    assert isinstance(refused, NoFix)
    assert dict(taken.evidence)["unsearched"] == dict(refused.evidence)["unsearched"] == pytest.approx(left_out, abs=0.02)
    assert ("too far to be searched" in refused.detail) == (left_out > 0)
