"""Where no corner of the board was seen: how sure the lens is there, and that it has rays there at all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.unit.prepare.board_pictures import LENSES, RATIONAL, corners_seen, poses
from tests.unit.prepare.test_lens_pictures import named, taken
from visloc_companion.geo.camera import project, unproject
from visloc_companion.geo.lens import reach_tan
from visloc_companion.prepare.defaults import DEFAULT_BOARD
from visloc_companion.prepare.lens.board import parse_board
from visloc_companion.prepare.lens.calibrate import Calibration, calibrate
from visloc_companion.prepare.lens.choose import candidates
from visloc_companion.prepare.lens.coverage import Coverage
from visloc_companion.prepare.lens.document import document, lines
from visloc_companion.prepare.lens.fit import fit, folds, free_numbers
from visloc_companion.prepare.lens.limits import shortcomings
from visloc_companion.prepare.lens.sure import covariance
from visloc_companion.prepare.lens.unseen import Unseen, cell_ends_pix, least_sure, ray_sigmas_px
from visloc_companion.prepare.lens.view import View
from visloc_companion.types import CameraModel, FloatArray

BOARD, SIZE = parse_board(DEFAULT_BOARD), (640, 480)
BENT_FAR_OUT = replace(RATIONAL, distortion=(0.9, 0.15, 0.0003, -0.0004, 0.3, 1.25, 0.4, 0.5))
"""k3 and k6 are of the size of the others: without them residuals are twice the noise."""


def views_of(model: CameraModel, seed: int, noise_px: float = 0.05, n: int = 14) -> list[View]:
    rng = np.random.default_rng(seed)
    seen = [corners_seen(model, BOARD, pose, rng, noise_px) for pose in poses(model, BOARD, n, rng)]
    return [view for view in seen if len(view.ids) >= 10]


def off_px(ours: CameraModel, true: CameraModel, views: list[View], places: FloatArray) -> FloatArray:
    """(N,) by how much the true lens shows our rays beside them, turned onto it where corners were seen."""
    seen = np.concatenate([view.pix for view in views])
    theirs, rays = (each / np.linalg.norm(each, axis=1)[:, None] for each in (unproject(true, seen), unproject(ours, seen)))
    U, _, Vt = np.linalg.svd(theirs.T @ rays)
    return np.hypot(*(project(true, unproject(ours, places) @ (U @ Vt).T) - places).T)


@pytest.mark.parametrize("seed", range(12))
def test_a_rational_lens_has_rays_wherever_corners_were_seen(seed: int) -> None:
    """More coefficients than the corners tell put a pole amid the picture: rays beyond it were up to 90 px off, at residuals of
    the noise."""
    views = views_of(RATIONAL, seed)
    lens = fit("rational", views, SIZE)
    assert not folds(lens, views)
    assert off_px(lens.model, RATIONAL, views, np.concatenate([view.pix for view in views])).max() < 1.0
    assert free_numbers(lens.model) == [0, 1, 2, 3, 4, 5, 6, 7, 9, 10], "k3 and k6 are not needed"
    known = np.diag(covariance(lens, views))
    assert known[8] == known[11] == 0.0
    assert (np.delete(known, [8, 11]) > 0).all()


def test_all_coefficients_are_fitted_where_the_views_tell_them() -> None:
    views = views_of(BENT_FAR_OUT, 3, 0.02)
    lens = fit("rational", views, SIZE)
    assert len(free_numbers(lens.model)) == 12
    assert off_px(lens.model, BENT_FAR_OUT, views, np.concatenate([view.pix for view in views])).max() < 0.3


def test_rays_err_by_what_is_stated_of_them() -> None:
    """Far ends of the picture's parts, seen or not, of three lenses; the fisheye's corners show nothing."""
    ratios = []
    for model in LENSES:
        for seed in range(5):
            views = views_of(model, 50 + seed)
            (found,) = candidates((model.distortion_model,), views, SIZE, str, {})
            assert found.lens is not None
            sigmas = ray_sigmas_px(found.lens.model, found.without, views).ravel()
            places = cell_ends_pix(found.lens.model)
            inner = np.isfinite(sigmas) & (np.hypot(*((places - (model.cx_px, model.cy_px)) / model.fx_px).T) < 1.2)
            off = off_px(found.lens.model, model, views, places[inner])
            ratios.append(float(np.sqrt(np.mean(np.square(off / sigmas[inner])))))
    assert 0.5 < float(np.median(ratios)) < 2.0, ratios
    assert max(ratios) < 6.0, ratios


def test_what_folds_before_a_place_is_not_sure_there() -> None:
    folded = replace(RATIONAL, distortion=(-0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert reach_tan(folded) < 1.1
    sigmas = ray_sigmas_px(folded, [folded] * 5, views_of(RATIONAL, 1))
    assert np.isinf(sigmas[0, 0])
    assert sigmas[3, 4] == pytest.approx(0.0, abs=1e-6)


def test_the_least_sure_part_is_one_that_shows_something_and_no_corner() -> None:
    counts, lit = np.ones((6, 8), np.int64), np.ones((6, 8), np.bool_)
    sigmas = np.arange(48.0).reshape(6, 8)
    assert least_sure(sigmas, Coverage(counts, lit)) is None
    counts[5, 7] = counts[0, 1] = counts[0, 6] = 0
    assert least_sure(sigmas, Coverage(counts, lit)) == Unseen("lower right", 47.0)
    lit[5, 7] = False
    assert least_sure(sigmas, Coverage(counts, lit)) == Unseen("upper right", 6.0)


@pytest.fixture(scope="module")
def wide() -> Calibration:
    """Of 14 views none reaches into the outermost upper left and lower left; GOOD, and rays up to 7 px off there."""
    return calibrate(named(taken(RATIONAL, 14, 0)), BOARD)


def test_a_guessed_corner_is_told_with_its_sigma(wide: Calibration) -> None:
    guessed = wide.least_sure
    assert guessed is not None
    assert guessed.sigma_px > 2.0
    assert any(line.startswith("where none were seen the lens is guessed: ") and guessed.part in line for line in lines(wide))
    (short,) = shortcomings(wide)
    assert short.what.startswith("the lens is guessed where no corner of the board was seen")
    assert "2.0 px may be" in short.what
    assert guessed.part in short.remedy
    told = document(wide)
    assert np.array(told["ray_sigma_px"], float).shape == (6, 8)
    assert told["good"] is False
    unseen = wide.coverage.lit & (wide.coverage.counts == 0)
    off = off_px(wide.lens.model, RATIONAL, wide.views, cell_ends_pix(wide.lens.model)).reshape(6, 8)[unseen]
    assert (off < 3 * wide.ray_sigmas_px[unseen]).all()
