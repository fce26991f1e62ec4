import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.localise.structure.base import LocalCloud, NoCloud, StereoSettings
from visloc_companion.localise.structure.cloud import local_cloud


@pytest.fixture(scope="module")
def truth(structure):
    return [structure.pose(0, step, 90, 1.5, -1.0, 2.0) for step in (-27, 0, 27)]


@pytest.fixture(scope="module")
def frames(structure, town, truth):
    return structure.flown(town, truth)


@pytest.fixture(scope="module")
def cloud(structure, frames):
    found = local_cloud(frames, structure.MODEL)
    assert isinstance(found, LocalCloud), found
    return found


def shape_errors(cloud, world):
    """Height errors after the shift, tilt and scale that all points share, which registration finds, and the raw ones."""
    raw = cloud.points_m[:, 2] - world.height(cloud.points_m[:, :2])
    A = np.column_stack([np.ones(len(raw)), cloud.points_m])
    near = abs(raw - np.median(raw)) < 1
    return raw - A @ np.linalg.lstsq(A[near], raw[near], rcond=None)[0], raw


def test_heights_of_boxes_are_right(cloud, town):
    shape, raw = shape_errors(cloud, town)
    assert np.median(abs(raw)) < 0.9  # 1 % of the height: two baselines of 27 m known to 0.28 m
    assert np.median(abs(shape)) < 0.1
    assert np.percentile(abs(shape), 90) < 0.35
    for box in town.boxes:
        e, n, up = cloud.points_m.T
        on = (e > box.west + 2) & (e < box.east - 2) & (n > box.south + 2) & (n < box.north - 2)
        ground = up[abs(shape) < 1][town.height(cloud.points_m[abs(shape) < 1][:, :2]) == 0]
        assert np.median(up[on]) - np.median(ground) == pytest.approx(box.height, rel=0.03)


def test_sigmas_are_those_of_the_heights(cloud, town):
    shape, _ = shape_errors(cloud, town)
    assert 0.4 < np.median(abs(shape) / cloud.sigma_m) / 0.6745 < 1.5


def test_most_of_the_common_ground_has_points(cloud):
    cells = np.unique(np.floor(cloud.points_m[:, :2]).astype(int), axis=0)
    inside = (abs(cells[:, 0]) < 60) & (abs(cells[:, 1]) < 40)
    assert inside.sum() > 0.9 * 120 * 80


def test_a_longer_flight_gives_a_longer_cloud_that_is_as_right(structure, town):
    """Seven frames from 40 m south to 40 m north of the middle: stars that share bases, one scale, no step between them."""
    frames = structure.flown(town, [structure.pose(0, 13.0 * k - 39, 90, 1.5, -1.0, 2.0) for k in range(7)])
    one, many = (local_cloud(frames, structure.MODEL, StereoSettings(max_stars=n)) for n in (1, 3))
    assert dict(many.evidence)["pairs"] > dict(one.evidence)["pairs"]
    assert np.ptp(many.points_m[:, 1]) > 1.3 * np.ptp(one.points_m[:, 1])
    shape, _ = shape_errors(many, town)
    assert np.median(abs(shape)) < 0.1
    north = many.points_m[:, 1]
    parts = [np.median(shape[(north > low) & (north < low + 25)]) for low in (-75, -50, -25, 0, 25, 50)]
    assert np.ptp(parts) < 0.25


def test_a_frame_in_which_nothing_is_found_again_does_not_spoil_the_others(structure, town, frames, truth):
    elsewhere = structure.World(structure.texture(7)).render(structure.MODEL, truth[0])
    found = local_cloud([replace(frames[0], pixels=elsewhere), *frames[1:]], structure.MODEL)
    assert isinstance(found, LocalCloud), found
    assert found.frames == (1, 2)
    assert len(found.T_local_cam) == 2
    assert np.median(abs(shape_errors(found, town)[0])) < 0.1


def test_poses_are_better_than_their_priors_relative_to_each_other(cloud, frames, truth):
    def tilt_apart(T, a, b):
        return T[a][:3, :3].T @ T[b][:3, :3]

    refined, prior = {i: cloud.pose_of(i) for i in cloud.frames}, {i: f.T_local_cam for i, f in enumerate(frames)}
    for a, b in ((0, 1), (1, 2)):
        right = tilt_apart(truth, a, b)
        error = [np.linalg.norm(cv2.Rodrigues(tilt_apart(T, a, b) @ right.T)[0]) for T in (refined, prior)]
        assert error[0] < 0.5 * error[1]
        assert error[0] < math.radians(0.25)


def test_pixels_are_where_the_reference_shows_the_points(cloud, structure):
    assert cloud.reference == 2
    shown = np.isfinite(cloud.pix).all(1)
    assert 0.3 < shown.mean() < 1
    T = cloud.pose_of(2)
    q = (cloud.points_m[shown] - T[:3, 3]) @ T[:3, :3]
    uv = q[:, :2] / q[:, 2:3] * structure.MODEL.fx_px + [structure.MODEL.cx_px, structure.MODEL.cy_px]
    np.testing.assert_allclose(uv, cloud.pix[shown], atol=1e-6)
    with pytest.raises(ValueError, match="not among those used"):
        cloud.pose_of(7)


def test_the_same_frames_give_the_same_cloud_on_any_number_of_threads(structure, frames, cloud):
    threads = cv2.getNumThreads()
    try:
        cv2.setNumThreads(3)
        again = local_cloud(frames, structure.MODEL)
    finally:
        cv2.setNumThreads(threads)
    np.testing.assert_array_equal(again.points_m, cloud.points_m)
    np.testing.assert_array_equal(again.T_local_cam, cloud.T_local_cam)


@pytest.mark.parametrize(("yaw", "roll", "pitch"), [(70, 0, 0), (200, 18, -8), (-30, -5, 19)])
def test_any_heading_and_tilts_to_twenty_degrees_through_a_lens(structure, town, yaw, roll, pitch):
    way = np.array([math.sin(0.4), math.cos(0.4)])
    truth = [structure.pose(*(way * s), 90, roll, pitch, yaw + 4 * k) for k, s in enumerate((0, 25))]
    found = local_cloud(structure.flown(town, truth, structure.WIDE), structure.WIDE)
    assert isinstance(found, LocalCloud), found
    shape, _ = shape_errors(found, town)
    assert np.median(abs(shape)) < 0.15


def test_large_frames_are_reduced_and_pixels_are_those_delivered(structure, frames, cloud, town):
    found = local_cloud(frames, structure.MODEL, StereoSettings(working_px=38_000))
    assert isinstance(found, LocalCloud), found
    assert len(found.points_m) < 0.7 * len(cloud.points_m) or found.sigma_m.mean() > cloud.sigma_m.mean()
    assert np.median(abs(shape_errors(found, town)[0])) < 0.2
    assert np.nanmax(found.pix[:, 0]) > 300
    assert np.nanmedian(found.pix, axis=0) == pytest.approx(np.nanmedian(cloud.pix, axis=0), abs=8)


def test_a_slope_is_a_slope(structure):
    world = structure.World(structure.texture(2), slope=0.25)
    truth = [structure.pose(s, 0, 90) for s in (-26, 0)]
    found = local_cloud(structure.flown(world, truth, sigma_m=0.02, sigma_deg=0.05), structure.MODEL)
    assert isinstance(found, LocalCloud), found
    inclined = np.polyfit(found.points_m[:, 0], found.points_m[:, 2], 1)[0]
    assert inclined == pytest.approx(0.25, abs=0.02)


def test_a_height_mends_a_scale_that_the_baseline_has_wrong(structure, town, truth):
    frames = structure.flown(town, truth, sigma_m=1e-3)
    wrong = []
    for frame, T in zip(frames, truth, strict=True):
        stretched = frame.T_local_cam.copy()
        stretched[:2, 3] *= 1.03
        ground = float(town.height(T[None, :2, 3])[0])
        wrong.append(replace(frame, T_local_cam=stretched, sigma_position_m=0.6, height_m=90 - ground))
    loose, tied = (local_cloud([replace(f, sigma_height_m=sigma) for f in wrong], structure.MODEL) for sigma in (math.inf, 0.2))
    ground = [c.T_local_cam[:, 2, 3].mean() - np.median(c.points_m[:, 2]) for c in (loose, tied)]
    assert ground[0] > 91.5
    assert ground[1] == pytest.approx(90, abs=0.6)
    assert tied.sigma_scale < 0.4 * loose.sigma_scale
    assert abs(ground[0] / 90 - 1) < 3 * loose.sigma_scale


def test_a_height_that_contradicts_the_baseline_is_refused(structure, town, truth):
    frames = structure.flown(town, truth)
    found = local_cloud([replace(f, height_m=75, sigma_height_m=0.2) for f in frames], structure.MODEL)
    assert isinstance(found, NoCloud)
    assert found.reason is Reason.INCONSISTENT_WITH_PRIOR


def refusal(structure, frames, settings=None):
    found = local_cloud(frames, structure.MODEL, settings)
    assert isinstance(found, NoCloud), found.evidence
    return found


def test_hover_is_refused(structure, town):
    found = refusal(structure, structure.flown(town, [structure.pose(0, 0.3 * k, 90) for k in range(3)]))
    assert found.reason is Reason.NO_BASELINE
    assert "hover" in found.detail


def test_turning_on_the_spot_is_refused(structure, town):
    found = refusal(structure, structure.flown(town, [structure.pose(0, 0, 90, yaw_deg=12.0 * k) for k in range(3)]))
    assert found.reason is Reason.NO_PARALLAX


def test_turning_while_the_odometry_claims_a_baseline_is_refused(structure, town):
    truth = [structure.pose(0, 0, 90, yaw_deg=5.0 * k) for k in range(2)]
    frames = structure.flown(town, truth)
    moved = frames[1].T_local_cam.copy()
    moved[1, 3] += 12.0
    found = refusal(structure, [frames[0], replace(frames[1], T_local_cam=moved)])
    assert found.reason in {Reason.NO_PARALLAX, Reason.TOO_FEW_FEATURES}


def test_water_is_refused(structure):
    world = structure.World(np.full((1280, 1280), 90, np.uint8))
    truth = [structure.pose(0, step, 90) for step in (0, 27)]
    assert refusal(structure, structure.flown(world, truth)).reason is Reason.LOW_TEXTURE


def test_water_with_glitter_is_refused(structure):
    truth = [structure.pose(0, step, 90) for step in (0, 27)]
    frames = [structure.posed(structure.World(structure.texture(k)).render(structure.MODEL, T), T) for k, T in enumerate(truth)]
    assert refusal(structure, frames).reason in {Reason.TOO_FEW_FEATURES, Reason.LOW_TEXTURE}


def test_a_smear_is_refused(structure, town, frames):
    kernel = np.zeros((61, 61), np.float32)
    kernel[:, 30] = 1 / 61  # along the flight, as a long exposure smears
    smeared = [replace(f, pixels=cv2.filter2D(f.pixels, -1, kernel)) for f in frames]
    found = refusal(structure, smeared)
    assert found.reason is Reason.BLURRED
    assert "smeared" in found.detail


def test_too_little_overlap_is_refused(structure, town):
    found = refusal(structure, structure.flown(town, [structure.pose(0, 70.0 * k, 90) for k in range(2)]))
    assert found.reason is Reason.LOW_OVERLAP


def test_too_few_points_are_refused(structure, frames):
    found = refusal(structure, frames, StereoSettings(min_points=10**6))
    assert found.reason is Reason.TOO_FEW_FEATURES


def test_one_frame_and_a_frame_of_another_size_are_refused(structure, frames):
    assert refusal(structure, frames[:1]).reason is Reason.BAD_INPUT
    assert refusal(structure, [frames[0], replace(frames[1], pixels=frames[1].pixels[:100])]).reason is Reason.BAD_FRAME


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"height_m": 0.0}, "frame 1: height_m is 0.0"),
        ({"sigma_tilt_rad": math.nan}, "frame 1: sigma_tilt_rad"),
        ({"T_local_cam": np.ones((4, 4))}, "frame 1: T_local_cam"),
        ({"T_local_cam": np.eye(3)}, "frame 1: T_local_cam"),
    ],
)
def test_poses_that_are_none_are_named(structure, frames, change, text):
    with pytest.raises(ValueError, match=text):
        local_cloud([frames[0], replace(frames[1], **change)], structure.MODEL)
