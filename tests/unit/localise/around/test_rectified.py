"""Frames of wide lenses, against those that a pinhole in their place takes, over the procedural landscape."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.unit.level_ground import apart, level_ground, over_its_middle
from visloc_companion.errors import Reason
from visloc_companion.geo.camera import pinhole_matrix, project, unproject
from visloc_companion.geo.pinhole_view import field_of_view_deg, pinhole_view
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.geo.wgs84 import distance_m, geo_from_ned
from visloc_companion.localise.around.rectified import rectified
from visloc_companion.localise.lens_maps import where_seen
from visloc_companion.localise.registry import make_localiser
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.world import ProceduralWorld
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_effects import CameraEffects
from visloc_companion.sim.scene import Scene
from visloc_companion.types import CameraModel, Fix, FrameRef, GeoPoint, Image, LocaliseRequest, NoFix, PosePrior, Quat

COEFFICIENTS = (0.02, -0.01, 0.003, -0.001)
PINHOLE = CameraModel(640, 480, 554.26, 554.26, 319.5, 239.5)
RATIONAL = CameraModel(640, 480, 290.0, 291.0, 330.0, 230.0, (1.2, 0.35, 3e-4, -2e-4, 0.01, 1.5, 0.7, 0.05), "rational")
LENS = CameraModel(320, 240, 180.0, 181.0, 163.0, 117.0, COEFFICIENTS, "fisheye")


def fisheye(diagonal_deg: float) -> CameraModel:
    focal_px = 400 / math.radians(diagonal_deg / 2)
    return CameraModel(640, 480, focal_px, focal_px, 322.0, 236.0, COEFFICIENTS, "fisheye")


@pytest.mark.parametrize("model", [LENS, RATIONAL, PINHOLE])
def test_pixels_of_a_view_are_sought_where_the_lens_shows_them(model: CameraModel) -> None:
    R = np.array([[0.96, -0.28, 0.0], [0.28, 0.96, 0.0], [0.0, 0.0, 1.0]])
    view = CameraModel(200, 150, 150.0, 160.0, 90.0, 70.0)
    map_u, map_v = where_seen(model, R, pinhole_matrix(view), (200, 150))
    v, u = np.mgrid[0:150, 0:200]
    want = project(model, unproject(view, np.column_stack([u.ravel(), v.ravel()]).astype(float)) @ R)
    assert np.column_stack([map_u.ravel(), map_v.ravel()]) == pytest.approx(want, abs=1e-3)


def test_a_rectified_frame_is_what_the_pinhole_in_its_place_sees() -> None:
    scene, place, q = level_ground(), over_its_middle(90.0), quat_from_euler(0.06, -0.1, 0.7)
    raw, view = CameraSimulator(scene, LENS).frame(place, q), pinhole_view(LENS)
    seen, told = CameraSimulator(scene, view).frame(place, q), rectified(raw, LENS)
    assert told.shape == seen.shape
    assert told.dtype == np.uint8
    assert apart(told, seen) < 2.0
    assert apart(np.roll(told, 2, axis=1), seen) > 10.0, "two pixels show"
    assert rectified(raw[..., 0], LENS).ndim == 2
    assert rectified(seen, PINHOLE) is seen


@dataclass(frozen=True)
class World:
    scene: Scene
    pack: PackMap
    place: GeoPoint


@pytest.fixture(scope="module")
def world(kept_world: Callable[..., ProceduralWorld]) -> World:
    files = kept_world(500.0, networks=())
    scene = Scene.load(files.flight_ortho, files.flight_dsm)
    width, height = scene.size_px
    lat, lon = map_crs(scene.crs).to_geo(*(scene.T_map_pix @ np.array([width / 2, height / 2, 1.0])))
    ground_m = float(np.median(scene.dsm_amsl_m[height // 2 - 50 : height // 2 + 50, width // 2 - 50 : width // 2 + 50]))
    return World(scene, PackMap.open(files.pack, verify_hashes=False), GeoPoint(lat, lon, ground_m + 90.0))


def request_near(place: GeoPoint, q: Quat, model: CameraModel) -> LocaliseRequest:
    cov, frame = ((100.0, 0.0), (0.0, 100.0)), FrameRef(0, 0, 1, 0, model.width_px, model.height_px, 3)
    prior = PosePrior(geo_from_ned((9.0, -7.0, 1.5), place), q, cov, 2.0, math.radians(3.0), math.radians(1.0))
    return LocaliseRequest(1, frame, prior, 1)


def rms_m(world: World, model: CameraModel) -> float:
    """Error of the network-free method over four places, the prior 11 m and about 2° off."""
    localiser = make_localiser("gradient", model)
    camera = CameraSimulator(world.scene, model, CameraEffects())
    errors = []
    for number, (north_m, east_m) in enumerate([(-45.0, -40.0), (30.0, -45.0), (-20.0, 45.0), (45.0, 35.0)]):
        place, yaw = geo_from_ned((north_m, east_m, 0.0), world.place), 0.4 + 1.3 * number
        pixels = camera.frame(place, quat_from_euler(0.03, -0.04, yaw), number)
        request = request_near(place, quat_from_euler(0.02, -0.05, yaw + 0.03), model)
        answer = localiser.localise(request, pixels, world.pack)
        assert isinstance(answer, Fix), answer
        errors.append(distance_m(answer.place, place))
    return math.sqrt(np.mean(np.square(errors)))


@pytest.fixture(scope="module")
def of_a_pinhole_m(world: World) -> float:
    return rms_m(world, PINHOLE)


@pytest.mark.parametrize("lens", [fisheye(120.0), fisheye(150.0), RATIONAL], ids=["120", "150", "rational"])
def test_a_wide_lens_is_placed_as_well_as_a_pinhole(world: World, lens: CameraModel, of_a_pinhole_m: float) -> None:
    assert field_of_view_deg(lens)[0] > 90.0
    assert rms_m(world, lens) <= of_a_pinhole_m < 1.0


def test_a_frame_of_another_size_is_refused_with_the_calibrated_one(world: World) -> None:
    lens = fisheye(150.0)
    pixels: Image = np.zeros((480, 641, 3), np.uint8)
    q = quat_from_euler(0.0, 0.0, 0.0)
    answer = make_localiser("gradient", lens).localise(request_near(world.place, q, lens), pixels, world.pack)
    assert isinstance(answer, NoFix)
    assert answer.reason is Reason.BAD_FRAME
    assert "640 x 480" in answer.detail
    assert rectified(pixels, lens) is pixels


def test_a_lens_taken_for_a_pinhole_is_placed_worse(world: World) -> None:
    """What the model is for: the same frame of a leaning camera, the distortion left out."""
    lens = fisheye(120.0)
    bare = replace(PINHOLE, fx_px=lens.fx_px, fy_px=lens.fy_px, cx_px=lens.cx_px, cy_px=lens.cy_px)
    place, q = world.place, quat_from_euler(0.2, 0.25, 0.4)
    pixels = CameraSimulator(world.scene, lens, CameraEffects()).frame(place, q, 1)
    request = request_near(place, q, lens)
    told, wrong = (make_localiser("gradient", m).localise(request, pixels, world.pack) for m in (lens, bare))
    assert isinstance(told, Fix)
    assert distance_m(told.place, place) < 1.0
    assert isinstance(wrong, NoFix) or distance_m(wrong.place, place) > 2.0
