"""The camera's mounting, learned from fixes: what is found, what is not taken for it, and what is said."""

from __future__ import annotations

import math
from random import Random

import numpy as np
import pytest

from visloc_companion.core.camera.boresight import Boresight
from visloc_companion.geo import se3
from visloc_companion.types import Fix, FloatArray, FrameRef, GeoPoint, LocaliseRequest, Notice, PosePrior, Quat

LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
HERE = GeoPoint(48.0, 11.0, 500.0)
COV = ((0.5, 0.0), (0.0, 0.5))


def mounted(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Quat:
    return se3.quat_from_euler(*(math.radians(a) for a in (roll_deg, pitch_deg, yaw_deg)))


def flown(
    learner: Boresight,
    truth: Quat,
    *,
    gnss_m: tuple[float, float] = (0.0, 0.0),
    delay_s: float = 0.0,
    turning: bool = True,
    share: float = 0.7,
    seconds: int = 240,
    height_m: float = 100.0,
    configured: Quat = LEVEL,
    seed: int = 1,
) -> list[Notice]:
    """A vehicle that hovers and flies in turn, into all directions or into one; fixes lay `share` of it into the place."""
    rng = Random(seed)
    said: list[Notice] = []
    for k in range(seconds):
        heading = 0.3 * (k // 8) if turning else 0.7
        speed = (0.0, 10.0, 5.0)[(k // 12) % 3] if turning else 10.0
        q = se3.quat_from_euler(rng.gauss(0, 0.03), rng.gauss(0, 0.03), heading)
        v = np.array([speed * math.cos(heading), speed * math.sin(heading), 0.0])
        prior = PosePrior(HERE, se3.quat_multiply(q, learner.q_frd_cambody), COV, 3.0, 0.05, 0.02)
        frame = FrameRef(k * 10**9, k * 10**9, k, 0, 640, 480, 3)
        learner.on_request(LocaliseRequest(k, frame, prior, 1))
        true = se3.quat_multiply(q, truth)
        R_true = se3.R_from_quat(true)
        solved = se3.slerp(true, prior.q_ned_frd, share)
        R = se3.R_from_quat(solved)
        looked: FloatArray = height_m * (R_true[:2, 2] / R_true[2, 2] - R[:2, 2] / R[2, 2])
        moved = looked + np.array([rng.gauss(0, 0.5), rng.gauss(0, 0.5)])
        minus = np.array(gnss_m) - delay_s * v[:2] - moved + np.array([rng.gauss(0, 0.5), rng.gauss(0, 0.5)])
        fix = Fix(0, frame.t_ns, k, k, "image", HERE, solved, COV, 1.0, 0.005, 1e-4, 1.0)
        said += learner.on_fix(fix, (float(minus[0]), float(minus[1])), (float(v[0]), float(v[1]), 0.0), height_m)  # type: ignore[arg-type]
    return said


@pytest.mark.parametrize("share", [0.0, 0.7, 1.0])
@pytest.mark.parametrize("wrong", [(2.0, 0.0, 0.0), (0.0, -2.0, 0.0), (1.5, 1.0, 2.0)])
def test_a_wrong_mount_is_found_however_fixes_share_it(wrong: tuple[float, float, float], share: float) -> None:
    """With all of it in the place, a fix's heading still is the picture's."""
    learner = Boresight(LEVEL)
    truth = mounted(*wrong)
    flown(learner, truth, share=share if wrong[2] == 0 else 0.0)
    off = math.degrees(se3.angle_between(learner.q_frd_cambody, truth))
    assert off < 0.5
    found = np.degrees(learner.turn_rad) - np.array(wrong)
    assert (np.abs(found[:2]) < 3 * np.degrees(learner.sigma_rad[:2]) + 0.1).all()


def test_it_is_found_on_a_camera_that_looks_ahead() -> None:
    configured, truth = mounted(0, 25, 0), se3.quat_multiply(mounted(0, 2, 0), mounted(0, 25, 0))
    learner = Boresight(configured)
    flown(learner, truth, configured=configured)
    assert math.degrees(se3.angle_between(learner.q_frd_cambody, truth)) < 0.5


@pytest.mark.parametrize("turning", [True, False])
def test_a_gnss_offset_is_not_taken_for_a_tilt(turning: bool) -> None:
    learner = Boresight(LEVEL)
    flown(learner, LEVEL, gnss_m=(4.0, -3.0), turning=turning)
    assert math.degrees(se3.angle_between(learner.q_frd_cambody, LEVEL)) < 0.3


def test_a_receiver_that_is_late_is_not_taken_for_a_tilt() -> None:
    learner = Boresight(LEVEL)
    flown(learner, LEVEL, delay_s=0.2)
    assert math.degrees(se3.angle_between(learner.q_frd_cambody, LEVEL)) < 0.3


def test_straight_ahead_the_sigma_says_that_it_is_not_known() -> None:
    learner = Boresight(LEVEL)
    flown(learner, mounted(2, 2, 0), turning=False)
    assert learner.q_frd_cambody == LEVEL
    assert (np.degrees(learner.sigma_rad[:2]) > 0.7).all()


def test_a_large_tilt_is_told_once_and_one_that_is_implausible_is_not_used() -> None:
    said = flown(Boresight(LEVEL), mounted(0, 4, 0))
    assert [n.text for n in said if n.to_operator] == ["visloc: camera tilted 4 deg off config"]
    assert all(len(n.text) <= 50 for n in said)
    learner = Boresight(LEVEL)
    flown(learner, mounted(0, 8, 0), seconds=400)
    assert math.degrees(se3.angle_between(learner.q_frd_cambody, LEVEL)) < 6.5


def test_low_doubtful_and_unasked_fixes_teach_nothing() -> None:
    learner = Boresight(LEVEL)
    fix = Fix(0, 10**9, 1, 1, "image", HERE, mounted(0, 2, 0), COV, 1.0, 0.005, 1e-4, 1.0)
    before = learner.sigma_rad
    assert learner.on_fix(fix, (0.0, 0.0), (1.0, 0.0, 0.0), 100.0) == []
    flown(learner, mounted(0, 2, 0), height_m=10.0, seconds=5)
    assert (learner.sigma_rad == before).all()


def test_a_camera_that_looks_aside_teaches_no_mounting() -> None:
    """Beyond 60 degrees the ground that it looks at lies too far off; straight down the same fixes teach."""
    for lean_deg, learns in ((10.0, True), (65.0, False)):
        learner, q = Boresight(LEVEL), mounted(0.0, lean_deg, 0.0)
        prior = PosePrior(HERE, q, COV, 3.0, 0.05, 0.02)
        learner.on_request(LocaliseRequest(1, FrameRef(0, 0, 1, 0, 640, 480, 1), prior, 1))
        before = learner.sigma_rad
        fix = Fix(0, 0, 1, 1, "test", HERE, q, COV, 1.0, 0.01, 1e-4, 1.0)
        assert learner.on_fix(fix, (0.0, 0.0), (0.0, 0.0, 0.0), 100.0) == []
        assert bool((learner.sigma_rad < 0.99 * before).any()) is learns
