"""What a frame tells of the tilt, apart from what was known of it before."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.geo import se3
from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.localise.candidates.tilt import beyond, seen_tilt, set_right
from visloc_companion.localise.dense import gradient_localiser
from visloc_companion.localise.ortho_rectify import CameraPose
from visloc_companion.localise.pose import PoseEstimate, PriorTerm, solve_pose
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.types import CameraModel, Fix, FloatArray, GeoPoint, PosePrior, Quat, TiltPrior, TiltSeen

K = np.array([[400.0, 0, 320], [0, 400.0, 240], [0, 0, 1]])
LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
TURN = (math.radians(0.7), math.radians(-0.4))
MODEL = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)


def believed(sigma_deg: float) -> PosePrior:
    cov = ((9.0, 0.0), (0.0, 9.0))
    return PosePrior(GeoPoint(47.0, 8.0, 150.0), LEVEL, cov, 2.0, math.radians(3.0), math.radians(sigma_deg))


def within(sigma_deg: float) -> PriorTerm:
    return PriorTerm(R_FRD_CAM, math.radians(sigma_deg), math.radians(3.0), 150.0, 2.0)


def estimate(noise: FloatArray, prior: PriorTerm) -> PoseEstimate:
    """From points seen with this noise (40, 2) by a camera that is tilted by TURN against the vertical."""
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(-80, 80, (40, 2)), np.zeros(40)])
    R = se3.R_from_quat(se3.quat_from_vector((*TURN, 0.0))) @ R_FRD_CAM
    q = (points - np.array([0.0, 0.0, -150.0])) @ R
    pix = q[:, :2] / q[:, 2:] * 400 + np.array([320, 240]) + noise
    start = CameraPose(np.array([0.0, 0.0, -150.0]), R_FRD_CAM)
    found = solve_pose(points, pix, np.full(40, 1.0), K, start, prior, 20)
    assert found is not None
    return found


def test_what_the_blocks_tell_does_not_depend_on_the_prior() -> None:
    noise = np.random.default_rng(5).normal(0, 1.0, (40, 2))
    tight, loose = (seen_tilt(estimate(noise, within(s)), believed(s)) for s in (0.3, 3.0))
    assert tight is not None
    assert loose is not None
    assert tight.turn_ne_rad == pytest.approx(loose.turn_ne_rad, abs=math.radians(0.1))
    assert np.array(tight.cov_rad2) == pytest.approx(np.array(loose.cov_rad2), rel=0.1, abs=1e-7)


def test_the_tilt_is_as_far_off_as_it_claims() -> None:
    rng, z = np.random.default_rng(6), []
    for _ in range(150):
        found = estimate(rng.normal(0, 1.0, (40, 2)), within(1.0))
        seen = seen_tilt(found, believed(1.0))
        assert seen is not None
        off = np.subtract(seen.turn_ne_rad, TURN)
        z.append(float(off @ np.linalg.solve(np.array(seen.cov_rad2), off)))
    assert np.mean(z) == pytest.approx(2.0, rel=0.25)


def test_blocks_that_know_no_tilt_say_nothing_of_it() -> None:
    found = replace(estimate(np.zeros((40, 2)), within(1.0)), covariance=np.diag([1.0, 1, 1, *[math.radians(1.0) ** 2] * 3]))
    assert seen_tilt(found, believed(1.0)) is None


def test_a_prior_is_set_right_by_what_is_known_of_its_tilt() -> None:
    plain = believed(1.0)
    assert set_right(plain) is plain
    right = set_right(replace(plain, tilt=TiltPrior(TURN, 0.004)))
    assert (right.sigma_tilt_rad, right.tilt) == (0.004, None)
    assert right.q_ned_frd == pytest.approx(se3.quat_from_vector((*TURN, 0.0)))
    seen = TiltSeen((0.001, 0.002), ((1e-5, 0.0), (0.0, 1e-5)))
    assert beyond(seen, None) is seen
    assert beyond(None, TiltPrior(TURN, 0.004)) is None
    total = beyond(seen, TiltPrior(TURN, 0.004))
    assert total is not None
    assert total.turn_ne_rad == pytest.approx((TURN[0] + 0.001, TURN[1] + 0.002))


def test_a_known_tilt_puts_the_fix_right_and_is_seen_again(flat, support):
    truth = (5.0, 8.0, -240.0)
    tilted = np.array([math.radians(1.5), math.radians(-1.0)])
    frame = support.render(flat, MODEL, truth, (0.0, 0.0, 0.0))
    request = support.request_at((0.0, 0.0, -240.0), (0.0, 0.0, 0.0))
    wrong = se3.quat_from_vector((-float(tilted[0]), -float(tilted[1]), 0.0))
    known = TiltPrior((float(tilted[0]), float(tilted[1])), math.radians(0.1))
    localiser, found = gradient_localiser(MODEL, LocaliserSettings()), []
    for tilt in (None, known):
        answer = localiser.localise(replace(request, prior=replace(request.prior, q_ned_frd=wrong, tilt=tilt)), frame, flat)
        assert isinstance(answer, Fix)
        assert answer.tilt is not None
        sigma = np.sqrt(np.diag(answer.tilt.cov_rad2))
        assert (np.abs(np.subtract(answer.tilt.turn_ne_rad, tilted)) < 3 * sigma + math.radians(0.1)).all()
        found.append(math.degrees(se3.angle_between(answer.q_ned_frd, LEVEL)))
    assert found[1] < 0.1 < found[0]


def test_the_chi2_of_the_tilt_is_that_of_two_degrees_of_freedom_while_claims_hold() -> None:
    rng, sigma, chi2 = np.random.default_rng(8), math.radians(0.5), []
    for _ in range(150):
        off = rng.normal(0, sigma, 2)
        R = se3.R_from_quat(se3.quat_from_vector((TURN[0] - off[0], TURN[1] - off[1], 0.0))) @ R_FRD_CAM
        prior = PriorTerm(R, sigma, math.radians(3.0), 150.0, 2.0)
        chi2.append(estimate(rng.normal(0, 1.0, (40, 2)), prior).tilt_sigmas ** 2)
    assert np.mean(chi2) == pytest.approx(2.0, rel=0.25)


def tilted_fix(ref, support, off_deg: float) -> tuple[Fix, float]:
    """A fix under a prior whose roll and pitch are both off by so much, known to 0.5 degrees, and how many metres it is off."""
    truth, off = (5.0, 8.0, -240.0), math.radians(off_deg)
    frame = support.render(ref, MODEL, truth, (0.0, 0.0, 0.0))
    request = support.request_at((0.0, 0.0, -240.0), (off, off, 0.0))
    answer = gradient_localiser(MODEL, LocaliserSettings()).localise(request, frame, ref)
    assert isinstance(answer, Fix)
    north, east, _ = ned_from_geo(answer.place, support.HOME)
    return answer, math.hypot(north - truth[0], east - truth[1])


def test_a_tilt_that_the_ground_contradicts_is_not_believed(hilly, support):
    answer, off_m = tilted_fix(hilly, support, 3.0)
    assert off_m < 1.5 * math.sqrt(np.trace(answer.cov_ne_m2))
    assert off_m < 2.0
    assert math.degrees(se3.angle_between(answer.q_ned_frd, LEVEL)) < 0.6
    assert answer.tilt is not None
    assert answer.tilt.turn_ne_rad == pytest.approx((math.radians(-3.0),) * 2, abs=math.radians(0.6))


@pytest.mark.parametrize(("ground", "off_deg"), [("hilly", 0.4), ("flat", 3.0)])
def test_a_tilt_is_believed_where_it_fits_or_the_ground_itself_may_lean(ground, off_deg, support, request, monkeypatch):
    ref = request.getfixturevalue(ground)
    found, _ = tilted_fix(ref, support, off_deg)
    monkeypatch.setattr("visloc_companion.localise.candidates.block_pose.CONTRADICTED_SIGMAS", math.inf)
    believed, _ = tilted_fix(ref, support, off_deg)
    assert (found.place, found.q_ned_frd, found.cov_ne_m2) == (believed.place, believed.q_ned_frd, believed.cov_ne_m2)
