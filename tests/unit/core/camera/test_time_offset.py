"""The offset that turns show."""

from __future__ import annotations

import math
from random import Random

import numpy as np
import pytest

from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera.time_offset import TimeOffset
from visloc_companion.geo import se3
from visloc_companion.types import Quat, Turn

LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
SIGMA = math.radians(0.1)
COV = ((SIGMA**2, 0.0, 0.0), (0.0, SIGMA**2, 0.0), (0.0, 0.0, SIGMA**2))
S = 1_000_000_000


def attitude_at(t_s: float, rocking_rad: float) -> Quat:
    roll = rocking_rad * (math.sin(2.1 * t_s) + 0.6 * math.sin(3.7 * t_s + 1))
    pitch = rocking_rad * (0.7 * math.sin(1.7 * t_s + 2) + 0.5 * math.sin(4.1 * t_s))
    return se3.quat_from_euler(roll, pitch, 0.4 * math.sin(0.3 * t_s))


def seen(
    offset_s: float,
    rocking_rad: float = 0.04,
    seconds: float = 60.0,
    mount: Quat = LEVEL,
    wrong_share: float = 0.0,
    seed: int = 1,
    offset: TimeOffset | None = None,
    start_s: float = 10.0,
    attitude_noise_rad: float = 0.0,
    wander_rad: float = 0.0,
) -> TimeOffset:
    """Turns of frames that were taken `offset_s` after their stamps; `attitude_noise_rad` is new in each attitude, and by
    `wander_rad` its error changes between two frames."""
    rng = np.random.default_rng(seed)
    draw = Random(seed)
    offset = offset or TimeOffset()
    attitude = AttitudeBuffer()
    sent_s, error = start_s - 2, np.zeros(3)
    for k in range(round(seconds / 0.25)):
        stamps = start_s + 0.25 * k, start_s + 0.25 * (k + 1)
        while sent_s < stamps[1] + 1:
            if wander_rad:
                error += rng.normal(0, wander_rad * math.sqrt(0.02 / 0.25), 3)
            new = rng.normal(0, attitude_noise_rad, 3) if attitude_noise_rad else 0.0
            x, y, z = ((error + new) / 2).tolist()
            told = se3.quat_multiply(attitude_at(sent_s, rocking_rad), se3.normalised((1.0, x, y, z)))
            attitude.add(round(sent_s * S), told, (0.0, 0.0, 0.0))
            sent_s += 0.02
        a, b = (se3.quat_multiply(attitude_at(t + offset_s, rocking_rad), mount) for t in stamps)
        noise = rng.normal(0, SIGMA if draw.random() >= wrong_share else math.radians(5), 3) / 2
        small = se3.normalised((1.0, float(noise[0]), float(noise[1]), float(noise[2])))
        q = se3.quat_multiply(se3.quat_multiply(se3.quat_inverse(a), b), small)
        turn = Turn(round(stamps[0] * S), round(stamps[1] * S), q, COV)
        assert offset.add(turn, (turn.t_from_ns, turn.t_to_ns), 0.0, attitude, mount)
    return offset


@pytest.mark.parametrize("offset_s", [-0.45, -0.3, -0.083, 0.0, 0.2])
def test_it_is_found_within_its_sigma(offset_s: float) -> None:
    best = seen(offset_s).best()
    assert best.sigma_s < 0.01
    assert abs(best.offset_s - offset_s) < 3 * best.sigma_s


def test_sigmas_are_honest() -> None:
    ratios = [(b.offset_s + 0.1) / b.sigma_s for b in (seen(-0.1, 0.01, 20.0, seed=k).best() for k in range(12))]
    assert 0.3 < float(np.sqrt(np.mean(np.square(ratios)))) < 1.5


@pytest.mark.parametrize("rocking_rad", [0.005, 0.02])
@pytest.mark.parametrize("seconds", [30.0, 120.0])
def test_what_attitudes_err_by_anew_in_each_sample_shows_no_offset(rocking_rad: float, seconds: float) -> None:
    ratios = []
    for seed in range(4):
        noise_rad = math.radians(0.1)
        best = seen(0.0, rocking_rad, seconds, seed=seed, attitude_noise_rad=noise_rad).best()
        ratios.append(best.offset_s / best.sigma_s)
    assert float(np.max(np.abs(ratios))) < 2.0


def test_it_is_found_beside_noise_by_a_vehicle_that_rocks_enough() -> None:
    best = seen(-0.1, 0.04, 120.0, attitude_noise_rad=math.radians(0.05)).best()
    assert best.sigma_s < 0.01
    assert abs(best.offset_s + 0.1) < 0.01


@pytest.mark.parametrize("wander_deg", [0.1, 0.2])
def test_an_attitude_whose_error_wanders_shows_no_offset_in_straight_flight(wander_deg: float) -> None:
    claimed = []
    for seed in range(4):
        offset, start_s = TimeOffset(), 10.0
        for block in range(8):
            wander_rad = math.radians(wander_deg)
            seen(0.0, 0.001, 10.0, seed=100 * seed + block, offset=offset, start_s=start_s, wander_rad=wander_rad)
            best = offset.best()
            claimed.append(abs(best.offset_s) / best.sigma_s)
            start_s += 10.0
    assert float(np.sqrt(np.mean(np.square(claimed)))) < 2.0


def test_it_is_found_beside_such_an_error_by_a_vehicle_that_rocks() -> None:
    best = seen(-0.1, 0.04, 30.0, wander_rad=math.radians(0.2)).best()
    assert best.sigma_s < 0.01
    assert abs(best.offset_s + 0.1) < 0.01


def test_it_is_found_with_a_camera_that_looks_ahead_and_with_wrong_turns() -> None:
    best = seen(-0.2, mount=se3.quat_from_euler(0.1, 0.6, 1.2), wrong_share=0.3).best()
    assert abs(best.offset_s + 0.2) < 0.01
    assert best.sigma_s < 0.01


def test_who_hardly_turns_does_not_learn_it() -> None:
    assert seen(-0.2, rocking_rad=0.0005, seconds=10.0).best().sigma_s > 0.05
    assert TimeOffset().best().sigma_s > 0.3


def test_an_offset_that_changes_is_followed() -> None:
    offset = seen(-0.1, seconds=120.0)
    best = seen(-0.25, seconds=60.0, offset=offset, start_s=200.0).best()
    assert abs(best.offset_s + 0.25) < 0.01


def test_turns_without_attitudes_about_them_are_left_out() -> None:
    attitude = AttitudeBuffer()
    turn = Turn(10 * S, 11 * S, LEVEL, COV)
    assert not TimeOffset().add(turn, (10 * S, 11 * S), 0.0, attitude, LEVEL)
    for k in range(60):
        attitude.add(8 * S + k * 100_000_000, LEVEL, (0.0, 0.0, 0.0))
    assert TimeOffset().add(turn, (10 * S, 11 * S), 0.0, attitude, LEVEL)
    assert not TimeOffset().add(turn, (11 * S, round(13.8 * S)), 0.0, attitude, LEVEL)  # the last ones are to come
    gap = AttitudeBuffer()
    for k in range(13):
        gap.add(8 * S + k * 400_000_000, LEVEL, (0.0, 0.0, 0.0))
    assert not TimeOffset().add(turn, (10 * S, 11 * S), 0.0, gap, LEVEL)
