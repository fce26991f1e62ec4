"""Turns from pictures of a textured plane."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from visloc_companion.geo.camera import R_FRD_CAM, project, scaled
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler, quat_inverse, quat_multiply
from visloc_companion.localise.odometry.rotation import TurnWatch
from visloc_companion.localise.odometry.turn_follow import Follower, of_ground
from visloc_companion.types import CameraModel, Image, Quat, Turn

MODEL = CameraModel(640, 480, 420.0, 420.0, 319.5, 239.5)
K = np.array([[420.0, 0.0, 319.5], [0.0, 420.0, 239.5], [0.0, 0.0, 1.0]])
S = 1_000_000_000
PX_PER_HEIGHT = 420.0


@pytest.fixture(scope="module")
def ground() -> Image:
    """A plane of texture of several sizes, four heights wide."""
    rng = np.random.default_rng(4)
    size = round(4 * PX_PER_HEIGHT)
    total = np.zeros((size, size), np.float32)
    for cells in (30, 120, 420):
        total += cv2.resize(rng.normal(0, 1, (cells, cells)).astype(np.float32), (size, size), interpolation=cv2.INTER_CUBIC)
    return np.asarray(np.clip(120 + 30 * total, 0, 255), dtype=np.uint8)


def q_of(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Quat:
    return quat_from_euler(*(math.radians(a) for a in (roll_deg, pitch_deg, yaw_deg)))


def picture(ground: Image, q: Quat, north: float = 0.0, east: float = 0.0) -> Image:
    """Seen from a height above the middle of the ground, moved by shares of it."""
    R = R_from_quat(q) @ R_FRD_CAM
    to_ground = np.diag([PX_PER_HEIGHT, PX_PER_HEIGHT, 1.0]) @ np.array(
        [[0.0, 1.0, 2 + east], [-1.0, 0.0, 2 - north], [0.0, 0.0, 1.0]]
    )
    H = to_ground @ R @ np.linalg.inv(K)
    return np.asarray(cv2.warpPerspective(ground, H, (640, 480), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP), dtype=np.uint8)


def error_deg(turn: Turn | None, a: Quat, b: Quat) -> np.ndarray:
    assert turn is not None
    off = quat_multiply(quat_inverse(quat_multiply(quat_inverse(a), b)), turn.q_from_to)
    return np.degrees(2 * np.array(off[1:]))


@pytest.mark.parametrize("told", ["truth", "other"])
@pytest.mark.parametrize("color", [False, True])
def test_the_turn_is_that_of_the_camera(ground: Image, told: str, color: bool) -> None:
    watch = TurnWatch(MODEL)
    poses = [(q_of(0, -4, 10), 0.0), (q_of(3, -6, 13), 0.04), (q_of(5, -3, 21), 0.09), (q_of(2, 0, 24), 0.12)]
    for k, (q, north) in enumerate(poses):
        seen = picture(ground, q, north)
        believed = q if told == "truth" else quat_multiply(q, q_of(4.0 * (k % 2), -3.0 * (k % 2), 5.0 * (k % 2)))
        turn = watch.step(np.repeat(seen[:, :, None], 3, axis=2) if color else seen, S + k * S // 5, believed).since_last
        if k == 0:
            assert turn is None
            continue
        assert turn is not None
        assert (turn.t_from_ns, turn.t_to_ns) == (S + (k - 1) * S // 5, S + k * S // 5)
        assert np.abs(error_deg(turn, poses[k - 1][0], q)).max() < 0.15
        assert (np.diag(np.array(turn.cov_rad2)) > 0).all()


@pytest.mark.parametrize("gain, offset", [(0.65, 0.0), (1.4, 0.0), (0.8, 40.0), (0.6, -20.0)])
def test_a_camera_sets_its_exposure_anew_in_each_frame(ground: Image, gain: float, offset: float) -> None:
    poses = [(q_of(0, -4, 10), 0.0), (q_of(3, -6, 13), 0.03), (q_of(4, -3, 17), 0.06), (q_of(2, 0, 20), 0.09)]
    watch, claimed = TurnWatch(MODEL), []
    for k, (q, north) in enumerate(poses):
        seen = picture(ground, q, north)
        exposed = np.asarray(np.clip(seen * gain + offset, 0, 255) if k % 2 else seen, dtype=np.uint8)
        turns = watch.step(exposed, S + k * S // 5, q)
        if k:
            assert np.abs(error_deg(turns.since_last, poses[k - 1][0], q)).max() < 0.1
            assert np.abs(error_deg(turns.since_kept, poses[0][0], q)).max() < 0.1
            assert turns.since_last is not None
            claimed.append(np.degrees(np.sqrt(np.diag(np.array(turns.since_last.cov_rad2)))).max())
    assert max(claimed) < 0.1


def with_text(seen: Image) -> Image:
    """What an on-screen display writes at the borders of the picture."""
    seen = seen.copy()
    lines = [(5, y) for y in (24, 48, 72, 430, 454)]
    for at in lines:
        cv2.putText(seen, "ALT 235.1 SPD 12.3 BAT 15.2V GPS 12", at, cv2.FONT_HERSHEY_SIMPLEX, 0.8, 255, 2)
    for at in [(x, y) for x in (10, 500) for y in range(120, 400, 40)]:
        cv2.putText(seen, "12:34:56", at, cv2.FONT_HERSHEY_SIMPLEX, 0.7, 255, 2)
    return seen


def test_a_text_in_the_picture_is_not_followed(ground: Image) -> None:
    """Turns were off by degrees, many times what they claimed, or there were none."""
    watch, sigmas = TurnWatch(MODEL), []
    poses = [(q_of(1.2 * math.sin(k), 0.6 * math.cos(k), 17.0), 0.025 * k) for k in range(10)]
    for k, (q, north) in enumerate(poses):
        turn = watch.step(with_text(picture(ground, q, north)), S + k * S // 4, q).since_last
        if turn is not None:
            off = np.radians(error_deg(turn, poses[k - 1][0], q))
            sigmas.append(math.sqrt(off @ np.linalg.solve(np.array(turn.cov_rad2), off) / 3))
    assert len(sigmas) >= 7
    assert max(sigmas) < 3.0


def test_what_stands_still_is_the_ground_where_all_does_or_little_moves() -> None:
    rng = np.random.default_rng(2)
    still, moved = rng.normal(0, 0.1, (30, 2)), np.add(rng.normal(0, 0.3, (50, 2)), (6.0, -2.0))
    assert np.array_equal(of_ground(np.vstack([still, moved])), np.arange(80) >= 30)
    assert of_ground(np.vstack([moved, still[:2]])).all(), "a few where the flow is zero"
    assert of_ground(still).all()
    assert of_ground(np.vstack([still, np.add(still, (1.2, 0.0))])).all()
    assert of_ground(np.zeros((0, 2))).shape == (0,)


def test_frames_that_are_late_old_identical_or_of_another_size_give_none(ground: Image) -> None:
    a, b = q_of(0, 0, 0), q_of(1, 1, 2)
    first, second = picture(ground, a), picture(ground, b)
    watch = TurnWatch(MODEL)
    assert watch.step(first, S, a).since_last is None
    assert watch.step(second, 3 * S, b).since_last is None  # too long ago
    assert watch.step(second, 3 * S + 1, b).since_last is None  # the camera is frozen
    assert watch.step(first, 2 * S, a).since_last is None  # older
    assert watch.step(second, round(2.2 * S), b).since_last is not None
    assert watch.step(second[:100], round(2.4 * S), b).since_last is None
    assert watch.step(first, round(2.6 * S), a).since_last is None


def test_what_shows_no_ground_gives_none(ground: Image) -> None:
    watch = TurnWatch(MODEL)
    q = q_of(0, 0, 0)
    assert watch.step(np.full((480, 640), 90, np.uint8), S, q).since_last is None
    assert watch.step(picture(ground, q), round(1.2 * S), q).since_last is None
    rng = np.random.default_rng(1)
    noise = np.asarray(cv2.GaussianBlur(rng.integers(0, 255, (480, 640)).astype(np.uint8), (0, 0), 3), dtype=np.uint8)
    assert watch.step(noise, round(1.4 * S), q).since_last is None
    steep = q_of(0, 70, 0)
    assert watch.step(picture(ground, q), round(1.6 * S), steep).since_last is None
    assert watch.step(picture(ground, q, 0.05), round(1.8 * S), steep).since_last is None


def test_turns_since_a_kept_frame_do_not_add_up(ground: Image) -> None:
    watch, kept_from = TurnWatch(MODEL), []
    poses = [(q_of(3.0 * math.sin(0.7 * k), -2.0 * math.cos(0.5 * k), 2.0 * k), 0.02 * k) for k in range(20)]
    for k, (q, north) in enumerate(poses):
        turns = watch.step(picture(ground, q, north), S + k * S // 5, q)
        if k == 0:
            assert turns.since_kept is None
            continue
        assert turns.since_kept is not None and turns.since_kept.t_to_ns == S + k * S // 5
        since = round((turns.since_kept.t_from_ns - S) / (S / 5))
        kept_from.append(since)
        assert np.abs(error_deg(turns.since_kept, poses[since][0], q)).max() < 0.15
    assert kept_from == [0] * 15 + [15] * 4, "3 s, then the frame before"
    lost = watch.step(np.full((480, 640), 90, np.uint8), S + 20 * S // 5, poses[-1][0])
    assert lost.since_last is None and lost.since_kept is None


def test_corners_of_a_strong_lens_are_given_their_rays(ground: Image) -> None:
    lens = CameraModel(640, 480, 330.0, 330.0, 319.5, 239.5, (-0.35, 0.12, 0.001, -0.002, 0.0))
    seen = Follower(lens).seen(picture(ground, q_of(0, 0, 0)), 0, R_FRD_CAM)
    assert seen is not None
    assert project(scaled(lens, 0.5), seen.rays) == pytest.approx(seen.corners, abs=1e-6)
