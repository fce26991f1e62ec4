"""Frames with landing gear in them, told by a mask: what is under it counts nowhere."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.unit.landing_gear import legs, masked, with_gear
from visloc_companion.errors import Reason
from visloc_companion.geo.camera import scaled
from visloc_companion.geo.pinhole_view import pinhole_view
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.localise.around.rectified import rectified
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.frame import check_pixels, full_level
from visloc_companion.localise.masked import MARGIN_RAD, behind_the_mask, ground_of, painted_over, with_margin
from visloc_companion.localise.registry import METHODS, make_localiser, needs_features
from visloc_companion.localise.working_size import reduced_model
from visloc_companion.types import CameraMask, CameraModel, Fix, GeoPoint, Image, NoFix, Vec3

MODEL = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)
FISHEYE = CameraModel(320, 240, 160.0, 160.0, 161.0, 118.0, (0.02, -0.01, 0.003, -0.001), "fisheye")


def test_a_mask_is_what_it_was_made_of_and_compares_by_it() -> None:
    ground = ~legs(37, 29)
    mask = CameraMask.of(ground)
    assert np.array_equal(mask.ground(), ground)
    assert mask.masked_share == pytest.approx(1 - ground.mean())
    assert {mask: 1}[CameraMask.of(ground.copy())] == 1
    assert mask != CameraMask.of(~ground)
    with pytest.raises(ValueError, match="a mask of 37 x 29 pixels, frames have 160 x 120"):
        replace(MODEL, mask=mask)


@pytest.mark.parametrize("size", [(80, 60), (53, 41), (160, 120)])
def test_a_smaller_pixel_shows_ground_where_all_that_it_is_made_of_does(size: tuple[int, int]) -> None:
    ground = ~legs(160, 120)
    small = CameraMask.of(ground).reduced(*size).ground()
    for row in range(0, size[1], 7):
        for column in range(size[0]):
            rows = slice(row * 120 // size[1], math.ceil((row + 1) * 120 / size[1]))
            columns = slice(column * 160 // size[0], math.ceil((column + 1) * 160 / size[0]))
            assert small[row, column] == ground[rows, columns].all()


def test_cameras_in_the_place_of_a_masked_one_are_masked_too() -> None:
    model = masked(MODEL)
    for other in (scaled(model, 0.5), reduced_model(model, 160 * 120 // 3)):
        assert other.mask is not None
        assert 0.9 < (1 - other.mask.masked_share) / (1 - model.mask.masked_share) < 1.0  # type: ignore[union-attr]
    assert scaled(MODEL, 0.5).mask is None


def test_the_mask_of_a_wide_lens_is_turned_as_its_frames_are() -> None:
    model = masked(FISHEYE)
    turned = rectified(ground_of(model), FISHEYE)
    seen = ground_of(pinhole_view(model))
    assert seen.shape == turned.shape
    assert np.mean((turned > 127) != (seen > 0)) < 1e-3
    assert replace(pinhole_view(model), mask=None) == pinhole_view(FISHEYE)


@pytest.mark.parametrize("color", [False, True])
def test_what_is_masked_is_painted_over_with_what_lies_around(color: bool) -> None:
    slope = np.tile(np.arange(60, 220, dtype=np.uint8), (120, 1))
    frame = np.dstack([slope, 255 - slope, slope]) if color else slope
    model, at = masked(MODEL), legs(160, 120)
    before = frame.copy()
    painted = painted_over(with_gear(frame), model)
    assert np.array_equal(painted[~at], before[~at])
    assert np.array_equal(painted, painted_over(with_gear(frame, seed=6), model)), "of the gear nothing is left"
    near = cv2.dilate((~at).astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    assert np.abs(painted.astype(float) - before)[at & near].max() < 30
    assert np.abs(with_gear(frame).astype(float) - before)[at & near].max() > 100
    assert painted_over(frame, MODEL) is frame
    assert painted_over(frame[:100], model).shape[0] == 100, "a frame of another size is for the localiser to refuse"


@pytest.mark.parametrize("kind", [np.uint16, np.float32])
def test_frames_of_other_numbers_are_refused_not_taken_modulo_256(kind, flat, support) -> None:
    model = masked(MODEL)
    frame = support.render(flat, MODEL, (5.0, 8.0, -240.0), (0.0, 0.0, 0.6)).astype(kind)
    localiser = behind_the_mask(lambda shown: make_localiser("gradient", shown), model)
    answer = localiser.localise(support.request_at((0.0, 0.0, -240.0), (0.0, 0.0, 0.6)), frame, flat)
    assert isinstance(answer, NoFix)
    assert answer.reason is Reason.BAD_FRAME


def test_a_margin_around_the_gear_is_left_out() -> None:
    ground = np.ones((120, 160), np.bool_)
    ground[60, 80] = False
    wide = with_margin(replace(MODEL, fx_px=500.0, fy_px=500.0, mask=CameraMask.of(ground)))
    radius = round(MARGIN_RAD * 500)
    column = ground_of(wide)[60]
    assert np.flatnonzero(column == 0).tolist() == list(range(80 - radius, 81 + radius))
    assert with_margin(MODEL) is MODEL


@pytest.mark.parametrize("distortion", [(0.0,) * 5, (-0.2, 0.05, 0.0, 0.0, 0.0)])
def test_levels_are_not_valid_where_the_mask_is(distortion: tuple[float, ...]) -> None:
    bare = replace(MODEL, distortion=distortion)
    model = masked(bare)
    frame = np.where(legs(160, 120), 0, 200).astype(np.uint8)
    level, whole = full_level(frame, model), full_level(frame, bare)
    assert np.array_equal(level.grey, whole.grey)
    assert (level.grey[level.valid > 0] >= 50).all(), "the nearest of the four that make up a pixel is ground"
    assert (level.grey[(level.valid == 0) & (whole.valid > 0)] <= 150).all()


def ground_texture(bright: float, contrast: float, sigma_px: float) -> Image:
    noise = np.random.default_rng(2).standard_normal((120, 160)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), sigma_px) if sigma_px else noise
    return np.clip(bright + contrast * smooth / smooth.std(), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("frame", "gear", "reason"),
    [
        (ground_texture(8, 3, 3), 250, Reason.TOO_DARK),
        (ground_texture(250, 3, 3), 10, Reason.OVEREXPOSED),
        (ground_texture(120, 0.8, 3), 10, Reason.LOW_TEXTURE),
        (ground_texture(120, 25, 0), 10, Reason.LOW_TEXTURE),
        (ground_texture(120, 25, 3), 10, None),
    ],
    ids=["night", "glare", "fog", "noise", "day"],
)
def test_whether_a_frame_shows_anything_is_told_by_its_ground(frame: Image, gear: int, reason: Reason | None) -> None:
    """Gear that the sun shines on is no ground by night, and dark gear no contrast in fog."""
    at = legs(160, 120)
    shown = np.where(at, gear, frame).astype(np.uint8)
    why = check_pixels(shown, masked(MODEL))
    assert (None if why is None else why[0]) == reason
    whole, untold = check_pixels(frame, MODEL), check_pixels(shown, MODEL)
    assert (None if whole is None else whole[0]) == reason
    assert reason is None or untold is None or untold[0] is not reason, "the gear deceives"


def test_a_mask_whose_margins_meet_leaves_nothing_to_look_at() -> None:
    stripes = np.tile(np.arange(160) % 3 > 0, (120, 1))
    why = check_pixels(ground_texture(120, 25, 3), with_margin(replace(MODEL, mask=CameraMask.of(stripes))))
    assert why == (Reason.LOW_TEXTURE, "the camera's mask, with its margin, leaves no ground")


def off_by_m(fix: Fix, truth: Vec3) -> float:
    return math.dist(ned_from_geo(fix.place, GeoPoint(47.0, 8.0, 0.0))[:2], truth[:2])


@pytest.mark.parametrize("method", METHODS)
def test_a_frame_is_found_again_beside_the_gear(method, flat, support) -> None:
    """Half of the picture is gear."""
    truth = (5.0, 8.0, -240.0)
    frame, asked = support.render(flat, MODEL, truth, (0.0, 0.0, 0.6)), support.request_at((0.0, 0.0, -240.0), (0.0, 0.0, 0.6))

    def made_for(model: CameraModel):
        features = GRADIENT if needs_features(method) else None
        return make_localiser(method, model, features=features, max_probability_wrong=1.0 if method == "keypoint" else 0.05)

    told = behind_the_mask(made_for, masked(MODEL))
    assert told.method == method
    answers = [told.localise(asked, with_gear(frame, seed), flat) for seed in (5, 6)]
    assert isinstance(answers[0], Fix), answers[0]
    assert off_by_m(answers[0], truth) < 0.4
    assert (answers[0].place, answers[0].cov_ne_m2) == (answers[1].place, answers[1].cov_ne_m2), "whatever the gear looks like"  # type: ignore[union-attr]
    if method not in ("keypoint", "mi"):  # these have enough in what is left
        untold = made_for(MODEL).localise(asked, with_gear(frame), flat)
        assert not isinstance(untold, Fix) or off_by_m(untold, truth) > 3 * off_by_m(answers[0], truth)


def test_nothing_is_in_between_where_there_is_no_mask() -> None:
    made = make_localiser("gradient", MODEL)
    assert behind_the_mask(lambda _: made, MODEL) is made
