"""The drag of a real copter, and what it tells of its velocity."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest

from visloc_companion.adapters.logs.open import open_log
from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.velocity.drag_velocity import WALK_PER_SQRT_S, DragLearner
from visloc_companion.core.velocity.forces import MIN_HEIGHT_M, Forces, Second
from visloc_companion.core.velocity.rotor_drag import WIND
from visloc_companion.types import Attitude, FloatArray, Imu, PriorPose

pytestmark = pytest.mark.shared

CUTS_S, CUT_S = range(60, 280, 20), 60.0


@functools.cache
def seconds(path: Path) -> list[Second]:
    """Of the flight of 2014, each with its own velocity, which rests on GNSS."""
    attitude, forces, found, height_m = AttitudeBuffer(), Forces(), [], 0.0
    for _, event in open_log(path).events:
        if isinstance(event, Attitude):
            attitude.add(event.t_boot_ns, event.q_ned_frd, event.rate_frd_radps)
        elif isinstance(event, PriorPose):
            height_m = event.h_rel_m
            forces.on_velocity(event.v_ned_mps, alone=False)
        elif isinstance(event, Imu) and height_m > MIN_HEIGHT_M:
            q_ned_frd = attitude.at(event.t_boot_ns)
            second = None if q_ned_frd is None else forces.on_force(event.t_boot_ns, event.force_frd_mps2, q_ned_frd)
            found += [] if second is None else [second]
    return found


def after_a_cut(flight: list[Second], cut_s: float) -> tuple[FloatArray, FloatArray]:
    """Error (N, 2) and claimed variance (N, 2) of the velocities of the minute after it, m/s."""
    learner, errors, claims = DragLearner(), [], []
    lasting, start_ns = np.zeros(2), flight[0].felt.t_boot_ns
    for second in flight:
        since_s = (second.felt.t_boot_ns - start_ns) * 1e-9 - cut_s
        if since_s < 0:
            learner.learn(second.felt, second.v_ned_mps, np.zeros((2, 2)))
            continue
        told = learner.velocity(second.felt, second.v_ned_mps)
        if since_s > CUT_S or told is None:
            continue
        more = told.error_m2ps2 if told.doubt_m2ps2 is None else told.doubt_m2ps2
        lasting = lasting + np.diag(more) + WALK_PER_SQRT_S[WIND] ** 2
        errors.append(np.array(told.v_ne_mps) - second.v_ned_mps[:2])
        claims.append(lasting + np.diag(told.noise_m2ps2))
    return np.array(errors).reshape(-1, 2), np.array(claims).reshape(-1, 2)


def test_the_drag_of_a_real_copter_tells_its_velocity_for_a_minute(shared_data: Path) -> None:
    """Beside it: accelerations alone were 3.4 to 4.3 m/s off on this flight after 20 s (test_propagation.py)."""
    flight = seconds(shared_data / "logs" / "copter_real_2014.bin")
    minutes = [after_a_cut(flight, cut_s) for cut_s in CUTS_S]
    error, claimed = np.concatenate([e for e, _ in minutes]), np.concatenate([c for _, c in minutes])
    assert len(error) > 400
    assert np.sqrt(np.mean(error**2)) < 1.4
    assert max(float(np.sqrt(np.mean(e**2))) for e, _ in minutes if len(e)) < 2.0
    assert 0.4 < np.sqrt(np.mean(error**2 / claimed)) < 1.1
    assert np.mean((error**2).sum(1) < 5.99 * claimed.mean(1)) > 0.95
