"""Views that are not of one lens: each fits by itself, and only together they say so."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.unit.prepare.board_pictures import BROWN, FISHEYE, LENSES, RATIONAL, Photographer, corners_seen, poses
from visloc_companion.prepare.defaults import DEFAULT_BOARD
from visloc_companion.prepare.lens.agree import Scatter, scatter
from visloc_companion.prepare.lens.board import parse_board
from visloc_companion.prepare.lens.calibrate import calibrate
from visloc_companion.prepare.lens.choose import MODELS, candidates, chosen
from visloc_companion.prepare.lens.detect import LEAST_CORNERS
from visloc_companion.prepare.lens.fit import fit
from visloc_companion.prepare.lens.limits import FOCAL_SHARE, shortcomings
from visloc_companion.prepare.lens.pictures import Picture
from visloc_companion.prepare.lens.view import View
from visloc_companion.types import CameraModel, FloatArray, Image

BOARD = parse_board(DEFAULT_BOARD)


def seen(models: list[CameraModel], seed: int, noise_px: float = 0.1, bent_m: float = 0.0) -> list[View]:
    def bent(at: FloatArray) -> FloatArray:
        across = at[:, 0] / at[:, 0].mean() - 1
        return at + np.column_stack([0 * across, 0 * across, bent_m * (1 - across**2)])

    rng = np.random.default_rng(seed)
    each = zip(models, poses(models[0], BOARD, len(models), rng), strict=True)
    views = [corners_seen(model, BOARD, pose, rng, noise_px, bent) for model, pose in each]
    return [view for view in views if len(view.ids) >= LEAST_CORNERS]


def scattered(views: list[View], model: CameraModel) -> Scatter:
    return scatter(fit(model.distortion_model, views, (model.width_px, model.height_px)), views)


@pytest.mark.parametrize("seed", range(61, 65))
@pytest.mark.parametrize("model", LENSES, ids=lambda model: model.distortion_model)
def test_views_of_one_lens_agree(model: CameraModel, seed: int) -> None:
    for noise_px, n in ((0.05, 20), (0.3, 20), (0.1, 8)):
        assert scattered(seen([model] * n, seed, noise_px), model) == Scatter(0.0, 0.0)


@pytest.mark.parametrize("seed", range(61, 65))
def test_a_sheet_that_is_hardly_bent_is_below_the_limit(seed: int) -> None:
    found = scattered(seen([BROWN] * 20, seed, bent_m=0.4e-3), BROWN)
    assert max(found.focal_share, found.centre_px / BROWN.fx_px) < FOCAL_SHARE


@pytest.mark.parametrize("seed", [61, 62])
def test_a_model_that_was_chosen_fits_well_enough(seed: int) -> None:
    for model in (RATIONAL, FISHEYE):
        views = seen([model] * 20, seed, 0.2)
        best = chosen(candidates(MODELS, views, (model.width_px, model.height_px), str, {}))
        assert best is not None
        assert best.lens is not None
        assert scatter(best.lens, views).focal_share < FOCAL_SHARE / 2


@pytest.mark.parametrize("seed", range(61, 65))
def test_a_zoom_that_moved_is_told_with_its_size(seed: int) -> None:
    by = 1 + 0.05 * np.random.default_rng(seed).random(20)
    models = [replace(BROWN, fx_px=BROWN.fx_px * share, fy_px=BROWN.fy_px * share) for share in by.tolist()]
    assert scattered(seen(models, seed), BROWN).focal_share == pytest.approx(0.05 / 12**0.5, rel=0.4)


@pytest.mark.parametrize("seed", range(61, 65))
def test_a_picture_that_was_stabilised_is_told_with_its_size(seed: int) -> None:
    by = np.random.default_rng(seed).normal(0, 8, (20, 2))
    models = [replace(BROWN, cx_px=BROWN.cx_px + u, cy_px=BROWN.cy_px + v) for u, v in by.tolist()]
    assert scattered(seen(models, seed), BROWN).centre_px == pytest.approx(8, rel=0.4)


def zoomed(shot: Image, by: float) -> Image:
    middle = ((shot.shape[1] - 1) / 2, (shot.shape[0] - 1) / 2)
    M = cv2.getRotationMatrix2D(middle, 0, by)
    return np.asarray(cv2.warpAffine(shot, M, shot.shape[::-1], flags=cv2.INTER_CUBIC), dtype=np.uint8)


def test_pictures_that_were_zoomed_or_turned_round_are_not_good() -> None:
    """Each view fits by itself, and both were accepted, the second with a principal point that was four sigmas off."""
    rng, take = np.random.default_rng(65), Photographer(BROWN, BOARD)
    shots = [take(pose, rng) for pose in poses(BROWN, BOARD, 16, rng)]
    for name, changed in (
        ("zoomed", [zoomed(shot, 1 + 0.04 * share) for shot, share in zip(shots, rng.random(16).tolist(), strict=True)]),
        ("turned", [shot if k % 2 else np.ascontiguousarray(shot[::-1, ::-1]) for k, shot in enumerate(shots)]),
    ):
        found = calibrate([Picture(f"{k}.png", shot) for k, shot in enumerate(changed)], BOARD, ("brown_conrady",))
        assert found.candidate.rms_px < 0.5, name
        told = [each for each in shortcomings(found) if "views contradict each other" in each.what]
        assert len(told) == 1, name
        assert "zoom locked, stabilisation off" in told[0].remedy
        assert not any("tilted" in each.remedy for each in shortcomings(found))
