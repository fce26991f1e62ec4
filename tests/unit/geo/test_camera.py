import cv2
import numpy as np
import pytest

from visloc_companion.geo.camera import R_FRD_CAM, project, reach_tan, scaled, unproject
from visloc_companion.types import CameraModel

PLAIN = CameraModel(640, 480, 500.0, 510.0, 319.5, 239.5)
BENT = CameraModel(640, 480, 500.0, 510.0, 321.0, 236.0, (-0.28, 0.09, 0.001, -0.0007, -0.01))


def points(n: int = 200) -> np.ndarray:
    rng = np.random.default_rng(3)
    return np.column_stack([rng.uniform(-0.55, 0.55, n), rng.uniform(-0.4, 0.4, n), np.ones(n)]) * rng.uniform(1, 300, (n, 1))


@pytest.mark.parametrize("model", [PLAIN, BENT])
def test_projection_is_opencv_s(model: CameraModel) -> None:
    K = np.array([[model.fx_px, 0, model.cx_px], [0, model.fy_px, model.cy_px], [0, 0, 1]])
    want = cv2.projectPoints(points(), np.zeros(3), np.zeros(3), K, np.array(model.distortion))[0].reshape(-1, 2)
    assert project(model, points()) == pytest.approx(want, abs=1e-9)


@pytest.mark.parametrize("model", [PLAIN, BENT])
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


@pytest.mark.parametrize("factor", [0.5, 0.25, 2.0])
def test_scaled_model_sees_the_resized_image(factor: float) -> None:
    small = scaled(BENT, factor)
    assert (small.width_px, small.height_px) == (640 * factor, 480 * factor)
    assert project(small, points()) == pytest.approx((project(BENT, points()) + 0.5) * factor - 0.5, abs=1e-9)


def test_scaled_model_keeps_a_pixel() -> None:
    assert (scaled(PLAIN, 0.0001).width_px, scaled(PLAIN, 0.0001).height_px) == (1, 1)
