"""From pictures to a lens: what is used, what is left out and why, and what is said of the result."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import cv2
import numpy as np
import pytest

from tests.unit.prepare.board_pictures import BROWN, FISHEYE, LENSES, RATIONAL, Photographer, poses
from visloc_companion.errors import CameraError
from visloc_companion.geo.camera import project, unproject
from visloc_companion.prepare.defaults import DEFAULT_BOARD
from visloc_companion.prepare.lens.board import Board, parse_board
from visloc_companion.prepare.lens.calibrate import Calibration, calibrate
from visloc_companion.prepare.lens.limits import shortcomings
from visloc_companion.prepare.lens.pictures import Picture
from visloc_companion.types import CameraModel, FloatArray, Image

BOARD = parse_board(DEFAULT_BOARD)
Shots = dict[str, list[Image]]


def taken(model: CameraModel, n: int, seed: int, board: str = DEFAULT_BOARD, **how: float) -> list[Image]:
    rng, sheet = np.random.default_rng(seed), parse_board(board)
    take = Photographer(model, sheet)
    return [take(pose, rng) for pose in poses(model, sheet, n, rng, **how)]


def named(shots: list[Image]) -> list[Picture]:
    return [Picture(f"p{k}.png", shot) for k, shot in enumerate(shots)]


@pytest.fixture(scope="module")
def shots() -> Shots:
    """Twelve pictures by each lens; boards reach over the rim of most."""
    return {model.distortion_model: taken(model, 12, 200) for model in LENSES}


@pytest.fixture(scope="module")
def brown(shots: Shots) -> Calibration:
    return calibrate(named(shots["brown_conrady"]), BOARD)


def off_px(found: Calibration, model: CameraModel) -> float:
    """By how much the found lens shows rays beside the true one, at most, where corners were seen.

    The boards' poses were found as well, so that both may look another way: they are turned onto each other first.
    """
    seen = np.concatenate([view.pix for view in found.views])
    true, ours = (
        rays / np.linalg.norm(rays, axis=1)[:, None] for rays in (unproject(of, seen) for of in (model, found.lens.model))
    )
    U, _, Vt = np.linalg.svd(ours.T @ true)
    return float(np.hypot(*(project(found.lens.model, true @ (U @ Vt).T) - seen).T).max())


@pytest.mark.parametrize("model", [RATIONAL, FISHEYE], ids=lambda model: model.distortion_model)
def test_a_wide_lens_is_found_with_its_model(shots: Shots, model: CameraModel) -> None:
    found = calibrate(named(shots[model.distortion_model]), BOARD)
    assert found.candidate.kind == model.distortion_model
    assert_right(found, model)


def test_a_narrow_lens_is_found_with_the_simplest_model(brown: Calibration) -> None:
    assert brown.candidate.kind == "brown_conrady"
    assert_right(brown, BROWN)
    assert [each.kind for each in brown.judged] == ["brown_conrady", "fisheye", "rational"]


def assert_right(found: Calibration, model: CameraModel) -> None:
    for key, sigma in found.sigmas.items():
        assert abs(getattr(found.lens.model, key) - getattr(model, key)) < 3 * sigma + 0.05, key
    assert off_px(found, model) < 0.3
    assert found.candidate.rms_px < 0.1
    assert found.focal_share < 0.002


def test_noise_and_compression_are_borne(shots: Shots) -> None:
    rng = np.random.default_rng(5)
    poor = []
    for shot in shots["brown_conrady"]:
        noisy = np.clip(cv2.GaussianBlur(shot, (0, 0), 1.0) + rng.normal(0, 8, shot.shape), 0, 255).astype(np.uint8)
        poor.append(cv2.imdecode(cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, 60])[1], cv2.IMREAD_GRAYSCALE))
    found = calibrate(named(poor), BOARD, ("brown_conrady",))
    assert off_px(found, BROWN) < 1.0
    assert all(abs(getattr(found.lens.model, k) - getattr(BROWN, k)) < 4 * sigma for k, sigma in found.sigmas.items())


def test_what_is_of_no_use_is_left_out_with_its_reason(shots: Shots) -> None:
    good = shots["brown_conrady"]
    blurred, wall = cv2.GaussianBlur(good[4], (0, 0), 4.0), np.full_like(good[0], 120)
    others = [good[2].copy(), cv2.resize(good[3], (320, 240)), wall, blurred]
    found = calibrate([*named(good), *(Picture(f"x{k}", p) for k, p in enumerate([*others, None]))], BOARD, ("brown_conrady",))
    why = found.looked.left_out
    assert why["x0"] == "is the same view as p2.png"
    assert why["x1"] == "is 320 x 240 px, most are 640 x 480"
    assert why["x2"] == "no board is seen"
    assert "blurred" in why["x3"] or "corners" in why["x3"] or "no board" in why["x3"]
    assert why["x4"] == "cannot be read as a picture"
    assert set(why) == {f"x{k}" for k in range(5)}
    assert off_px(found, BROWN) < 0.3


def sheared(shot: Image) -> Image:
    """As a shutter that rolls shows what moves to the side."""
    height, width = shot.shape
    v, u = np.mgrid[0:height, 0:width].astype(np.float32)
    return cv2.remap(shot, u + 6 * np.sin(v / 60), v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def test_a_view_that_was_shaken_is_named_and_left_out(shots: Shots) -> None:
    good = shots["brown_conrady"]
    found = calibrate(named([*good[:5], sheared(good[5]), *good[6:]]), BOARD, ("brown_conrady",))
    assert set(found.outlying) == {"p5.png"}
    assert off_px(found, BROWN) < 0.3


def test_too_many_of_them_are_refused(shots: Shots) -> None:
    mixed = [sheared(shot) if k % 3 == 0 else shot for k, shot in enumerate(shots["brown_conrady"])]
    with pytest.raises(
        CameraError, match=r"\d of 12 views contradict the others \(p0.png, p3.png, .*hold camera and board still"
    ):
        calibrate(named(mixed), BOARD, ("brown_conrady",))


def test_the_size_of_the_squares_cancels(shots: Shots, brown: Calibration) -> None:
    """A sheet that was printed at 91 % has the same lens: only how far away it was comes out wrong."""
    told = replace(BOARD, square_m=BOARD.square_m * 1.1, marker_m=BOARD.marker_m * 1.1)
    found = calibrate(named(shots["brown_conrady"]), told, ("brown_conrady",))
    assert found.lens.model.fx_px == pytest.approx(brown.lens.model.fx_px, abs=1e-3)
    assert found.lens.poses[:, 3:] == pytest.approx(1.1 * brown.lens.poses[:, 3:], rel=1e-4)


def test_boards_that_are_never_tilted_do_not_pass() -> None:
    found = calibrate(named(taken(BROWN, 8, 7, tilt_deg=0.0)), BOARD, ("brown_conrady",))
    short = shortcomings(found)
    assert "focal length is not determined" in short[0].what
    assert "tilted" in short[0].remedy
    assert max(found.tilts_deg) < 5


def test_a_sheet_that_was_stretched_does_not_pass(shots: Shots, brown: Calibration) -> None:
    assert not brown.sheet.sure
    told = BoardOfOtherColumns(BOARD.kind, BOARD.columns, BOARD.rows, BOARD.square_m, BOARD.marker_m, BOARD.dictionary)
    found = calibrate(named(shots["brown_conrady"]), told, ("brown_conrady",))
    short, *_ = shortcomings(found)
    assert "the sheet is 2.0 % longer across than down: the focal length is" in short.what
    assert "measure both rulers" in short.remedy


class BoardOfOtherColumns(Board):
    """Whose columns are told to be narrower by 2 % than they were printed."""

    @cached_property
    def corners_m(self) -> FloatArray:
        return super().corners_m * (1 / 1.02, 1.0, 1.0)


def test_a_corner_of_the_picture_without_the_board_is_named(shots: Shots) -> None:
    hidden = [shot.copy() for shot in shots["brown_conrady"]]
    for shot in hidden:
        shot[:200, :240] = 120
    found = calibrate(named(hidden), BOARD, ("brown_conrady",))
    assert [each.remedy for each in shortcomings(found)] == ["more views with the board towards the upper left"]
    for shot in hidden:
        shot[:200, :240] = 0  # what a wide lens leaves black is no part of its picture
    assert shortcomings(calibrate(named(hidden), BOARD, ("brown_conrady",))) == []


def test_a_mirrored_picture_is_told() -> None:
    mirrored = [np.ascontiguousarray(shot[:, ::-1]) for shot in taken(BROWN, 2, 1)]
    with pytest.raises(CameraError, match=r"seen in none of 2 pictures; remedy: pictures are mirrored"):
        calibrate(named(mirrored), BOARD)


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ("charuco:11x8:22mm:16mm:5X5_100", "markers of dictionary 4X4_1000 are seen, not of 5X5_100"),
        ("charuco:8x11:22mm:16mm", "of its markers are seen, but not where they should be: check COLUMNSxROWS"),
    ],
)
def test_another_board_is_told(shots: Shots, told: str, said: str) -> None:
    with pytest.raises(CameraError, match=said):
        calibrate(named(shots["brown_conrady"][:3]), parse_board(told))


def test_no_board_at_all_is_told() -> None:
    wall = named([np.full((480, 640), 90, np.uint8)] * 3)
    with pytest.raises(CameraError, match=r"p0.png: the board is seen in none of 3 pictures; remedy: check --board charuco"):
        calibrate(wall, BOARD)


def test_too_few_views_are_refused(shots: Shots) -> None:
    with pytest.raises(CameraError, match=r"5 of 6 pictures can be used, 6 are needed: wall no board is seen"):
        calibrate([*named(shots["fisheye"][:5]), Picture("wall", np.full((480, 640), 90, np.uint8))], BOARD)


def test_a_chessboard_serves_too() -> None:
    found = calibrate(
        named(taken(BROWN, 12, 3, "chessboard:8x5:25mm", far=1.5)), parse_board("chessboard:8x5:25mm"), ("brown_conrady",)
    )
    assert off_px(found, BROWN) < 0.3
    assert found.focal_share < 0.002
