"""The pinhole camera in the place of a wide one: what it keeps of the view, and that the frame fills it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.geo.camera import project, unproject
from visloc_companion.geo.lens import reach_tan
from visloc_companion.geo.pinhole_view import field_of_view_deg, inner_reach, pinhole_view, why_folded
from visloc_companion.types import CameraMask, CameraModel

RATIONAL = CameraModel(640, 480, 290.0, 291.0, 330.0, 230.0, (1.2, 0.35, 3e-4, -2e-4, 0.01, 1.5, 0.7, 0.05), "rational")


def fisheye(diagonal_deg: float, distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)) -> CameraModel:
    focal_px = 400 / math.radians(diagonal_deg / 2)
    return CameraModel(640, 480, focal_px, focal_px, 326.0, 233.0, distortion, "fisheye")


@pytest.mark.parametrize("model", [RATIONAL, *(fisheye(angle) for angle in (60.0, 100.0, 120.0, 150.0, 180.0, 220.0))])
def test_the_frame_fills_the_view_to_its_corners_at_the_scale_of_its_middle(model: CameraModel) -> None:
    view = pinhole_view(model)
    assert (view.fx_px, view.fy_px, any(view.distortion)) == (model.fx_px, model.fy_px, False)
    u, v = np.meshgrid(np.linspace(0, view.width_px - 1, 41), np.linspace(0, view.height_px - 1, 41))
    rays = unproject(view, np.column_stack([u.ravel(), v.ravel()]))
    pix = project(model, rays)
    assert (pix > -0.01).all()
    assert (pix < np.array([model.width_px, model.height_px]) - 0.99).all()
    assert (np.hypot(rays[:, 0], rays[:, 1]) < reach_tan(model)).all()


@pytest.mark.parametrize(
    ("diagonal_deg", "kept_deg"), [(60.0, (48.0, 36.0)), (120.0, (96.0, 72.0)), (150.0, (110.0, 90.0)), (200.0, (110.0, 110.0))]
)
def test_the_field_of_view_is_kept_up_to_110_degrees(diagonal_deg: float, kept_deg: tuple[float, float]) -> None:
    centred = replace(fisheye(diagonal_deg), cx_px=319.5, cy_px=239.5)
    assert field_of_view_deg(centred)[0] == pytest.approx(diagonal_deg * 640 / 800, abs=0.3)
    assert field_of_view_deg(pinhole_view(centred)) == pytest.approx(kept_deg, abs=0.4)


def test_what_a_calibration_does_not_reach_is_left_out() -> None:
    short = fisheye(150.0, (-0.2, 0.0, 0.0, 0.0))
    view = pinhole_view(short)
    corner = unproject(view, np.array([[0.0, 0.0], [view.width_px - 1.0, view.height_px - 1.0]]))
    assert np.hypot(corner[:, 0], corner[:, 1]).max() < reach_tan(short)


def test_a_brown_conrady_camera_stays_as_it_is() -> None:
    bent = CameraModel(640, 480, 330.0, 330.0, 319.5, 239.5, (-0.3, 0.1, 0.0, 0.0, 0.0))
    assert pinhole_view(bent) is bent


def test_where_a_mapping_folds_is_told_as_a_share_of_the_way_to_the_border() -> None:
    assert inner_reach(fisheye(150.0)) == math.inf
    turning = math.sqrt(1 / 0.6)
    folding = fisheye(150.0, (-0.2, 0.0, 0.0, 0.0))
    assert inner_reach(folding) == pytest.approx(turning * (1 - 0.2 * turning**2) * folding.fx_px / 233.5)


def test_a_mapping_that_folds_within_the_picture_is_named_and_one_that_folds_beyond_it_is_not() -> None:
    folding = fisheye(150.0, (-0.5, 0.0, 0.0, 0.0))
    why = why_folded(folding)
    assert why is not None
    assert f"fisheye lens folds back within the picture, at {100 * inner_reach(folding):.0f} %" in why
    assert inner_reach(folding) < 1.0
    assert why_folded(fisheye(60.0, (-0.2, 0.0, 0.0, 0.0))) is None


def test_a_mask_is_turned_as_the_frames_are() -> None:
    """The lower third of the picture shows landing gear: below a ray that lies on its border the view is masked, too."""
    ground = np.ones((480, 640), np.bool_)
    ground[320:] = False
    model = replace(fisheye(120.0), mask=CameraMask.of(ground))
    view = pinhole_view(model)
    assert view.mask is not None
    seen = view.mask.ground()
    assert seen.shape == (view.height_px, view.width_px)
    v, u = np.mgrid[0 : view.height_px, 0 : view.width_px]
    row = project(model, unproject(view, np.column_stack([u.ravel(), v.ravel()]).astype(np.float64)))[:, 1].reshape(u.shape)
    assert (seen == (row < 319.5))[np.abs(row - 319.5) > 1e-6].all()
    assert 0.2 < seen.mean() < 0.9
