import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from visloc_companion.geo.camera import R_FRD_CAM, pinhole_matrix, project, scaled, unproject
from visloc_companion.geo.lens import reach_tan
from visloc_companion.types import CameraModel, DistortionModel

PLAIN = CameraModel(640, 480, 500.0, 510.0, 319.5, 239.5)
BENT = CameraModel(640, 480, 500.0, 510.0, 321.0, 236.0, (-0.28, 0.09, 0.001, -0.0007, -0.01))
RATIONAL = CameraModel(640, 480, 290.0, 291.0, 322.0, 236.0, (1.2, 0.35, 3e-4, -2e-4, 0.01, 1.5, 0.7, 0.05), "rational")
FISHEYE = CameraModel(640, 480, 306.0, 305.0, 322.0, 236.0, (0.02, -0.01, 0.003, -0.001), "fisheye")
LENSES = (PLAIN, BENT, RATIONAL, FISHEYE)


def points(n: int = 200) -> np.ndarray:
    rng = np.random.default_rng(3)
    return np.column_stack([rng.uniform(-0.55, 0.55, n), rng.uniform(-0.4, 0.4, n), np.ones(n)]) * rng.uniform(1, 300, (n, 1))


def projected_by_opencv(model: CameraModel, p_cam_m: np.ndarray) -> np.ndarray:
    K = np.array([[model.fx_px, 0, model.cx_px], [0, model.fy_px, model.cy_px], [0, 0, 1]])
    coefficients, still = np.array(model.distortion), np.zeros(3)
    if model.distortion_model == "fisheye":
        return cv2.fisheye.projectPoints(p_cam_m[:, None], still, still, K, coefficients)[0].reshape(-1, 2)
    return cv2.projectPoints(p_cam_m, still, still, K, coefficients)[0].reshape(-1, 2)


@pytest.mark.parametrize("model", LENSES)
def test_projection_is_opencv_s(model: CameraModel) -> None:
    assert project(model, points()) == pytest.approx(projected_by_opencv(model, points()), abs=1e-9)
    wide = points() * (4.0, 4.0, 1.0)
    if model.distortion_model != "brown_conrady":
        assert project(model, wide) == pytest.approx(projected_by_opencv(model, wide), abs=1e-9)


@pytest.mark.parametrize("model", LENSES)
def test_rays_go_back_through_their_pixels(model: CameraModel) -> None:
    u, v = np.meshgrid(np.linspace(0, 639, 9), np.linspace(0, 479, 7))
    pix = np.column_stack([u.ravel(), v.ravel()])
    rays = unproject(model, pix)
    assert (rays[:, 2] == 1).all()
    assert project(model, rays * 57.0) == pytest.approx(pix, abs=1e-3)


@pytest.mark.parametrize(
    ("focal_px", "distortion"),
    [
        (330.0, (-0.35, 0.12, 0.001, -0.002, 0.0)),
        (280.0, (-0.3, 0.1, 0.001, -0.002, -0.01)),
        (600.0, (-0.3, 0.0, 0.0, 0.0, 0.0)),
        (330.0, (0.25, 0.05, 0.0, 0.0, 0.0)),
        (400.0, (0.5, 0.3, 0.001, 0.001, 0.0)),
        (280.0, (0.1, -0.2, 0.0, 0.0, 0.5)),
    ],
)
def test_rays_of_strong_lenses_go_back_through_their_pixels(focal_px: float, distortion: tuple[float, ...]) -> None:
    model = CameraModel(640, 480, focal_px, focal_px, 319.5, 239.5, distortion)
    u, v = np.meshgrid(np.linspace(0, 639, 17), np.linspace(0, 479, 13))
    pix = np.column_stack([u.ravel(), v.ravel()])
    rays = unproject(model, pix)
    assert project(model, rays) == pytest.approx(pix, abs=1e-6)
    assert (np.hypot(rays[:, 0], rays[:, 1]) < reach_tan(model)).all()


@pytest.mark.parametrize("diagonal_deg", [100.0, 140.0, 178.0])
@pytest.mark.parametrize("distortion", [(0.0, 0.0, 0.0, 0.0), (-0.04, 0.01, -0.003, 0.0), (0.12, -0.05, 0.02, -0.003)])
def test_rays_of_fisheyes_go_back_through_their_pixels(diagonal_deg: float, distortion: tuple[float, ...]) -> None:
    half = math.radians(diagonal_deg / 2)
    angle = half * (1 + sum(k * half ** (2 * n) for n, k in enumerate(distortion, start=1)))
    focal_px = math.hypot(320.0, 240.0) / angle
    model = CameraModel(640, 480, focal_px, focal_px, 319.5, 239.5, distortion, "fisheye")
    u, v = np.meshgrid(np.linspace(0, 639, 17), np.linspace(0, 479, 13))
    pix = np.column_stack([u.ravel(), v.ravel()])
    rays = unproject(model, pix)
    assert project(model, rays) == pytest.approx(pix, abs=1e-6)
    corner_deg = np.degrees(np.arctan(np.hypot(rays[0, 0], rays[0, 1])))
    assert corner_deg == pytest.approx(diagonal_deg / 2, abs=0.3)


@pytest.mark.parametrize(
    ("model", "distortion", "reach"),
    [
        ("fisheye", (-0.2, 0.0, 0.0, 0.0), math.tan((1 / 0.6) ** 0.5)),
        ("fisheye", (-0.1, 0.0, 0.0, 0.0), math.inf),  # turns only beyond a right angle
        ("rational", (-0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (1 / 0.9) ** 0.5),
        ("rational", (0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0), 2.0**0.5),
        ("rational", (0.0, 0.0, 0.0, 0.0, 0.0, -0.25, 0.0, 0.0), 2.0),  # a pole
    ],
)
def test_where_a_lens_folds(model: DistortionModel, distortion: tuple[float, ...], reach: float) -> None:
    folding = CameraModel(640, 480, 300.0, 300.0, 319.5, 239.5, distortion, model)
    assert reach_tan(folding) == pytest.approx(reach)
    if math.isfinite(reach):
        just = [project(folding, np.array([[r, 0.0, 1.0]]))[0, 0] for r in reach * np.array([0.98, 0.99, 0.999, 1.001, 1.01])]
        assert just[0] < just[1] < just[2]
        assert just[4] < just[2]


def test_a_model_has_the_coefficients_of_its_kind() -> None:
    with pytest.raises(ValueError, match="fisheye has 4 coefficients, not 5"):
        replace(PLAIN, distortion_model="fisheye")
    with pytest.raises(ValueError, match="rational has 8 coefficients, not 4"):
        replace(FISHEYE, distortion_model="rational")


def test_pixels_beyond_what_the_polynomial_reaches_get_its_last_ray() -> None:
    model = CameraModel(640, 480, 330.0, 330.0, 319.5, 239.5, (-0.3, 0.0, 0.0, 0.0, 0.0))
    reach = reach_tan(model)
    assert reach == pytest.approx((1 / 0.9) ** 0.5)
    corner = unproject(model, np.array([[0.0, 0.0], [639.0, 479.0]]))
    assert np.hypot(corner[:, 0], corner[:, 1]) == pytest.approx([reach, reach])
    assert corner[0, :2] == pytest.approx(reach * np.array([-0.8, -0.6]), abs=1e-3)
    assert reach_tan(PLAIN) == np.inf
    assert unproject(model, np.zeros((0, 2))).shape == (0, 3)


def test_behind_the_camera_is_not_a_number() -> None:
    assert np.isnan(project(PLAIN, np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]]))).all()
    assert project(PLAIN, np.array([[0.0, 0.0, 5.0]])) == pytest.approx(np.array([[319.5, 239.5]]))


def test_camera_looks_down_with_its_top_forward() -> None:
    assert (R_FRD_CAM @ [0, 0, 1] == [0, 0, 1]).all(), "optical axis = body down"
    assert (R_FRD_CAM @ [0, -1, 0] == [1, 0, 0]).all(), "top of the image = forward"
    assert (R_FRD_CAM @ [1, 0, 0] == [0, 1, 0]).all(), "right of the image = body right"


@pytest.mark.parametrize("model", [BENT, RATIONAL, FISHEYE])
@pytest.mark.parametrize("factor", [0.5, 0.25, 2.0])
def test_scaled_model_sees_the_resized_image(factor: float, model: CameraModel) -> None:
    small = scaled(model, factor)
    assert (small.width_px, small.height_px) == (640 * factor, 480 * factor)
    assert project(small, points()) == pytest.approx((project(model, points()) + 0.5) * factor - 0.5, abs=1e-9)


def test_scaled_model_sees_an_image_that_is_resized_to_whole_pixels() -> None:
    """752 x 480 to a width of 320: 204 and not 204.3 rows, which is 0.12 % less."""
    model = replace(BENT, width_px=752, height_px=480)
    small = scaled(model, 320 / 752)
    assert (small.width_px, small.height_px) == (320, 204)
    assert project(small, points()) == pytest.approx((project(model, points()) + 0.5) * [320 / 752, 204 / 480] - 0.5, abs=1e-9)


def test_scaled_model_keeps_a_pixel() -> None:
    assert (scaled(PLAIN, 0.0001).width_px, scaled(PLAIN, 0.0001).height_px) == (1, 1)


@pytest.mark.parametrize("model", [PLAIN, replace(PLAIN, fx_px=411.0, fy_px=402.0, cx_px=300.5, cy_px=251.0)])
def test_the_matrix_projects_what_the_lens_does_not_bend(model: CameraModel) -> None:
    rays = points()
    pix = (pinhole_matrix(model) @ rays.T).T
    assert pix[:, :2] / pix[:, 2:] == pytest.approx(project(model, rays), abs=1e-9)
