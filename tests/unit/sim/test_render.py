"""The renderer against scenes whose pictures are known by formula."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from visloc_companion.geo.camera import R_FRD_CAM, project
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler
from visloc_companion.geo.wgs84 import radii_m
from visloc_companion.maps.crs import map_crs
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_effects import AIRLIGHT, CameraEffects, apply_effects
from visloc_companion.sim.scene import Scene
from visloc_companion.types import CameraModel, FloatArray, GeoPoint, Image, Quat

CRS = "EPSG:32632"
EAST, NORTH, GROUND_M, BLOCK_M = 604_000.0, 5_350_000.0, 430.0, 455.0
BLOCK = (slice(560, 640), slice(560, 640))
PINHOLE = CameraModel(320, 240, 270.0, 275.0, 160.0, 118.0)
LENS = CameraModel(320, 240, 270.0, 275.0, 160.0, 118.0, (-0.18, 0.06, 0.001, -0.0015, 0.0))


def scene_with_dots(dots_pix: list[tuple[int, int]], gsd_m: float = 0.5, block: bool = True) -> Scene:
    """1200 x 1200 px of dark ground at 430 m with a paler block 25 m high in the middle and bright round dots."""
    pixels = np.full((1200, 1200, 3), 60, np.uint8)
    dsm = np.full((1200, 1200), GROUND_M, np.float32)
    if block:
        pixels[BLOCK] = 120
        dsm[BLOCK] = BLOCK_M
    rows, columns = np.mgrid[0:13, 0:13] - 6.0
    bump = np.exp(-(rows**2 + columns**2) / (2 * 1.6**2))[:, :, None] * 130
    for u, v in dots_pix:
        window = (slice(v - 6, v + 7), slice(u - 6, u + 7))
        pixels[window] = np.maximum(pixels[window], (pixels[v, u].astype(float) + bump).astype(np.uint8))
    T_map_pix = np.array([[gsd_m, 0.0, EAST], [0.0, -gsd_m, NORTH]])
    return Scene(pixels, dsm, T_map_pix, CRS)


def place_at(pix: tuple[float, float], h_amsl_m: float, gsd_m: float = 0.5) -> GeoPoint:
    lat, lon = map_crs(CRS).to_geo(EAST + gsd_m * pix[0], NORTH - gsd_m * pix[1])
    return GeoPoint(lat, lon, h_amsl_m)


def expected_pix(scene: Scene, model: CameraModel, camera: GeoPoint, q: Quat, dot: tuple[float, float]) -> FloatArray:
    """Where a dot of the scene must appear, by way of the CRS and geo.camera alone."""
    local = map_crs(CRS).linearised_at(camera)
    at_map = scene.T_map_pix @ np.array([*dot, 1.0])
    north_east = np.linalg.solve(local.J_map_ne, at_map - np.array(local.origin_map_m))
    down = camera.h_amsl_m - float(scene.dsm_amsl_m[int(dot[1]), int(dot[0])])
    p_cam = (R_from_quat(q) @ R_FRD_CAM).T @ np.array([*north_east, down])
    return project(model, p_cam[None])[0]


def seen_pix(image: Image, near: FloatArray) -> FloatArray:
    """Centre of brightness above the local background, within 14 px of a place (windowed, iterated)."""
    grey = image[:, :, 1].astype(float)
    v, u = np.mgrid[0 : grey.shape[0], 0 : grey.shape[1]]
    at = near
    for _ in range(8):
        close = np.hypot(u - at[0], v - at[1]) < 9
        weight = np.where(close, grey - grey[close].min(), 0) ** 2
        at = np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()
    return at


@pytest.mark.parametrize("model", [PINHOLE, LENS], ids=["pinhole", "distorted"])
@pytest.mark.parametrize(("roll_deg", "pitch_deg", "yaw_deg"), [(0, 0, 0), (4, -3, 200), (0, 30, 90), (-20, 10, 310)], ids=str)
def test_dots_on_plane_and_block_appear_where_the_pinhole_says(
    model: CameraModel, roll_deg: float, pitch_deg: float, yaw_deg: float
) -> None:
    dots = [(u, v) for u in range(400, 820, 30) for v in range(400, 820, 30) if not _near_edge(u, v)]
    scene = scene_with_dots(dots)
    camera = place_at((601.3, 587.2), GROUND_M + 120.0)
    q = quat_from_euler(*(math.radians(a) for a in (roll_deg, pitch_deg, yaw_deg)))
    image = CameraSimulator(scene, model).frame(camera, q)
    errors = []
    for dot in dots:
        expected = expected_pix(scene, model, camera, q, dot)
        in_view = np.isfinite(expected).all() and (expected > 14).all() and (expected < np.array([305, 225])).all()
        if in_view and not _hidden(scene, camera, dot):
            errors.append(np.hypot(*(seen_pix(image, expected) - expected)))
    assert len(errors) >= 12
    assert np.median(errors) < 0.05
    assert max(errors) < 0.1


def _near_edge(u: int, v: int) -> bool:
    outside = max(abs(u - 599.5), abs(v - 599.5)) - 40
    return -9 < outside < 9


def _hidden(scene: Scene, camera: GeoPoint, dot: tuple[int, int]) -> bool:
    """Whether the straight line from a ground dot (or its surroundings) to the camera passes through the block."""
    if scene.dsm_amsl_m[dot[1], dot[0]] > GROUND_M:
        return False
    easting, northing = map_crs(CRS).to_map(camera.lat_deg, camera.lon_deg)
    at = np.array([(easting - EAST) / 0.5, (NORTH - northing) / 0.5])
    share = np.linspace(0, (BLOCK_M - GROUND_M) / (camera.h_amsl_m - GROUND_M), 60)[:, None]
    line = np.array(dot) + share * (at - np.array(dot))
    return bool((np.abs(line - 599.5).max(1) < 52).any())


def test_tilt_of_45_degrees_shows_the_block_in_front_and_hides_the_ground_behind_it() -> None:
    dots = [(600, 530), (600, 430), (620, 610), (600, 668), (700, 600), (500, 600)]
    scene = scene_with_dots(dots)
    camera = place_at((600.0, 740.0), GROUND_M + 70.0)
    q = quat_from_euler(0.0, math.radians(45.0), 0.0)
    image = CameraSimulator(scene, PINHOLE).frame(camera, q)
    for dot in ((600, 430), (620, 610), (600, 668), (700, 600), (500, 600)):
        expected = expected_pix(scene, PINHOLE, camera, q, dot)
        assert np.hypot(*(seen_pix(image, expected) - expected)) < 0.1, dot
    hidden = expected_pix(scene, PINHOLE, camera, q, (600, 530)).round().astype(int)
    behind = image[hidden[1] - 3 : hidden[1] + 4, hidden[0] - 3 : hidden[0] + 4]
    assert behind.max() <= 121, "the dot 15 m behind the block (25 m high) must not shine through"


def test_camera_below_the_highest_surface_of_the_frame_still_sees_past_it() -> None:
    scene = scene_with_dots([(500, 600)])
    camera = place_at((500.0, 600.0), GROUND_M + 20.0)
    image = CameraSimulator(scene, PINHOLE).frame(camera, quat_from_euler(0.0, 0.0, 0.0))
    assert np.hypot(*(seen_pix(image, np.array([160.0, 118.0])) - np.array([160.0, 118.0]))) < 0.3


def test_colour_is_averaged_over_the_ground_of_each_pixel() -> None:
    chequered = (np.indices((1200, 1200)).sum(0) % 2 * 200).astype(np.uint8)
    T_map_pix = np.array([[0.5, 0.0, EAST], [0.0, -0.5, NORTH]])
    scene = Scene(np.dstack([chequered] * 3), np.full((1200, 1200), GROUND_M, np.float32), T_map_pix, CRS)
    camera = place_at((600.0, 600.0), GROUND_M + 400.0)
    image = CameraSimulator(scene, CameraModel(160, 120, 135.0, 135.0, 79.5, 59.5)).frame(camera, quat_from_euler(0, 0, 0))
    assert abs(float(image.mean()) - 100.0) < 1.5
    assert float(image.std()) < 4.0


def test_rays_past_the_scene_and_above_the_horizon_show_air() -> None:
    scene = scene_with_dots([], block=False)
    away = CameraSimulator(scene, PINHOLE).frame(place_at((600.0, 9000.0), GROUND_M + 100.0), quat_from_euler(0, 0, 0))
    assert (away == np.array(AIRLIGHT, np.uint8)).all()
    level = CameraSimulator(scene, PINHOLE).frame(
        place_at((600.0, 600.0), GROUND_M + 100.0), quat_from_euler(0.0, math.radians(85.0), 0.0)
    )
    assert (level[:100] == np.array(AIRLIGHT, np.uint8)).all()
    assert (level[-20:] == 60).all()


def test_the_same_seed_gives_the_same_frame_and_another_seed_other_noise() -> None:
    scene = scene_with_dots([(590, 590)])
    simulator = CameraSimulator(scene, PINHOLE, CameraEffects())
    camera, q = place_at((600.0, 600.0), GROUND_M + 100.0), quat_from_euler(0.02, 0.01, 1.0)
    first, again, other = (simulator.frame(camera, q, seed) for seed in (7, 7, 8))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    assert np.array_equal(CameraSimulator(scene, PINHOLE, CameraEffects()).frame(camera, q, 7), first)


@pytest.mark.parametrize("seeds", [(1, 2), (3, 4), (5, 6), (7, 8)])
def test_the_noise_of_two_frames_is_not_the_same_field_shifted(seeds: tuple[int, int]) -> None:
    dark = np.zeros((240, 320, 3), np.uint8)
    effects = CameraEffects(exposure_mean=0.0, exposure_jitter=0.0, vignetting=0.0, motion_blur_px=0.0, read_noise=20.0)
    a, b = (apply_effects(dark, np.ones((240, 320), np.float32), effects, s)[:, :, 0].astype(float) for s in seeds)
    spectra = [np.fft.fft2(p - p.mean()) for p in (a, b)]
    correlation = np.abs(np.fft.ifft2(spectra[0] * np.conj(spectra[1]))) / (a.size * a.std() * b.std())
    assert correlation.max() < 6 / math.sqrt(a.size)


def test_geographic_crs_puts_north_up_and_east_right() -> None:
    lat, lon, step = 48.3, 10.4, 0.5 / 111_200
    pixels = np.full((800, 800, 3), 60, np.uint8)
    cv2.circle(pixels, (400, 340), 4, (240, 240, 240), -1, cv2.LINE_AA)
    T = np.array([[step / math.cos(math.radians(lat)), 0.0, lon], [0.0, -step, lat]])
    scene = Scene(pixels, np.full((800, 800), GROUND_M, np.float32), T, "EPSG:4326")
    lat0, lon0 = lat - 400 * step, lon + 400 * step / math.cos(math.radians(lat))
    image = CameraSimulator(scene, PINHOLE).frame(GeoPoint(lat0, lon0, GROUND_M + 100.0), quat_from_euler(0, 0, 0))
    expected = np.array([160.0, 118.0 - 275.0 * 60 * 0.5 / 100.0])
    assert np.hypot(*(seen_pix(image, expected) - expected)) < 0.4


@pytest.mark.parametrize("middle_lon_deg", [179.9999, -179.9999, 180.0001, -180.0001])
def test_a_scene_in_degrees_is_seen_from_both_sides_of_the_antimeridian(middle_lon_deg: float) -> None:
    """From beyond it, the scene lay 38,000 km away: the camera saw nothing but hazy air."""
    degree_m = radii_m(-17.5)[1] * math.cos(math.radians(17.5)) * math.pi / 180
    size_deg = 0.5 / degree_m
    T_map_pix = np.array([[size_deg, 0, middle_lon_deg - 599.5 * size_deg], [0, -size_deg, -17.5 + 599.5 * size_deg]])
    scene = replace(scene_with_dots([]), T_map_pix=T_map_pix, crs="EPSG:4326")
    for lon_deg in (179.9997, -179.9997):
        place = GeoPoint(-17.5, lon_deg, GROUND_M + 120.0)
        assert scene.reach_m(place) > 200.0
        frame = CameraSimulator(scene, PINHOLE).frame(place, quat_from_euler(0.0, 0.0, 0.0))
        assert set(np.unique(frame)) <= set(range(55, 125)), "the ground and the block, no air"
