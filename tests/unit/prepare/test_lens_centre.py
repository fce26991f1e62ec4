"""A lens out of centre behind a model that has no word for it, and models compared by views of which one errs most."""

from __future__ import annotations

import numpy as np
import pytest

from tests.unit.prepare.board_pictures import FISHEYE, RATIONAL, corners_seen, poses
from visloc_companion.prepare.defaults import DEFAULT_BOARD
from visloc_companion.prepare.lens.board import parse_board
from visloc_companion.prepare.lens.calibrate import calibrate
from visloc_companion.prepare.lens.centre import OffCentre, off_centre
from visloc_companion.prepare.lens.choose import MODELS, Candidate, candidates, chosen
from visloc_companion.prepare.lens.document import document, lines
from visloc_companion.prepare.lens.fit import fit
from visloc_companion.prepare.lens.look import CELLS, Looked
from visloc_companion.prepare.lens.sure import covariance
from visloc_companion.prepare.lens.view import View
from visloc_companion.types import CameraModel, DistortionModel, FloatArray

BOARD = parse_board(DEFAULT_BOARD)
SIZE = (640, 480)


def views_of(model: CameraModel, seed: int, noise_px: float) -> list[View]:
    rng = np.random.default_rng(seed)
    seen = [corners_seen(model, BOARD, pose, rng, noise_px) for pose in poses(model, BOARD, 14, rng)]
    return [View(f"{k}", view.ids, view.board_m, view.pix) for k, view in enumerate(seen) if len(view.ids) >= 10]


def principal(model: CameraModel) -> FloatArray:
    return np.array([model.cx_px, model.cy_px])


@pytest.mark.parametrize("seed", [1000, 1003, 1004])
def test_a_lens_out_of_centre_is_told_behind_a_fisheye_with_what_it_costs(seed: int) -> None:
    """The principal point lay up to 7 of its sigmas off."""
    views = views_of(RATIONAL, seed, 0.1)
    lens = fit("fisheye", views, SIZE)
    error, off = principal(lens.model) - principal(RATIONAL), off_centre(lens, views)
    sigma = np.sqrt(np.diag(covariance(lens, views)))[2:4]
    assert off.sure
    assert np.abs(error / sigma).max() > 3.5
    assert np.abs(error + off.step[2:4]).max() < 0.5 * np.abs(error).max()
    assert np.abs(error / np.hypot(sigma, off.step[2:4])).max() < 2.5


@pytest.mark.parametrize("noise_px", [0.05, 0.3])
def test_a_lens_in_centre_is_not_doubted(noise_px: float) -> None:
    for seed in range(1000, 1006):
        views = views_of(FISHEYE, seed, noise_px)
        off = off_centre(lens := fit("fisheye", views, SIZE, FISHEYE), views)
        assert not off.sure
        assert np.abs(off.step[2:4]).max() < 3 * np.sqrt(np.diag(covariance(lens, views)))[2:4].max()


def test_a_model_that_has_the_term_needs_no_other() -> None:
    views = views_of(RATIONAL, 1000, 0.1)
    off = off_centre(fit("rational", views, SIZE, RATIONAL), views)
    assert not off.sure
    assert not off.step.any()


def judged(kind: DistortionModel, held_out_px: list[float], off: bool = False) -> Candidate:
    return Candidate(kind, None, np.square(held_out_px), "", OffCentre(np.zeros(8), off))


def test_one_view_that_nothing_else_tells_of_does_not_decide() -> None:
    """It alone reaches into a corner of the picture, and the model with more coefficients goes anywhere there: 13 of 14 views
    say that this model is better."""
    rng = np.random.default_rng(3)
    best, worse = rng.normal(0.03, 0.003, 14), rng.normal(0.044, 0.003, 14)
    best[5], worse[5] = 0.32, 0.045
    of = [judged("fisheye", worse.tolist()), judged("rational", best.tolist())]
    assert of[0].rms_px < of[1].rms_px
    assert (found := chosen(of)) is not None
    assert found.kind == "rational"


def test_a_fisheye_for_a_lens_out_of_centre_gives_way_to_what_is_as_good() -> None:
    alike = [0.2] * 14
    for other, kind in (([0.2] * 14, "rational"), ([0.4] * 14, "fisheye")):
        assert (found := chosen([judged("fisheye", alike, off=True), judged("rational", other)])) is not None
        assert found.kind == kind
    assert (found := chosen([judged("fisheye", alike), judged("rational", alike)])) is not None
    assert found.kind == "fisheye"


@pytest.mark.parametrize("seed", [1000, 1004, 1006])
def test_noise_does_not_hide_a_lens_out_of_centre(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """With 0.2 px of noise `fisheye` or `brown_conrady` was taken, and the principal point 4 to 7 sigmas off."""
    views = views_of(RATIONAL, seed, 0.2)
    looked = Looked(views, SIZE, {}, np.full(CELLS[::-1], 200.0))
    monkeypatch.setattr("visloc_companion.prepare.lens.calibrate.look_at", lambda pictures, board: looked)
    found = calibrate([], BOARD)
    error = principal(found.lens.model) - principal(RATIONAL)
    assert np.abs(error / [found.sigmas["cx_px"], found.sigmas["cy_px"]]).max() < 3
    assert found.candidate.kind == "rational" or not found.off_centre.sure


def test_a_lens_out_of_centre_is_said_where_fisheye_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    looked = Looked(views_of(RATIONAL, 1000, 0.1), SIZE, {}, np.full(CELLS[::-1], 200.0))
    monkeypatch.setattr("visloc_companion.prepare.lens.calibrate.look_at", lambda pictures, board: looked)
    found = calibrate([], BOARD, ("fisheye",))
    assert any("out of centre, for which fisheye has nothing: cx may be off by" in line for line in lines(found))
    assert document(found)["off_centre"]["sure"] is True


def test_the_kind_of_a_lens_is_found_again() -> None:
    assert (found := chosen(candidates(MODELS, views_of(FISHEYE, 1001, 0.1), SIZE, str, {}))) is not None
    assert found.kind == "fisheye"
