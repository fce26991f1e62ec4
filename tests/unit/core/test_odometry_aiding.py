from __future__ import annotations

import math

import pytest

from visloc_companion.core.odometry_aiding import OdometryAiding
from visloc_companion.types import Odometry

MS = 1_000_000


def seen(from_ms: int, to_ms: int, north_m: float, east_m: float = 0.0, scale: float = 0.01) -> Odometry:
    cov = ((0.02 + (scale * north_m) ** 2, 0.0), (0.0, 0.02 + (scale * east_m) ** 2))
    return Odometry(to_ms * MS, from_ms * MS, to_ms * MS, (north_m, east_m, 0.0), cov, scale, 0.0)


def test_intervals_follow_each_other_and_cover_the_way() -> None:
    aiding = OdometryAiding()
    motions = []
    for leg in range(4):
        for k in range(1, 11):
            motions.append(aiding.on_odometry(seen(1000 * leg, 1000 * leg + 100 * k, 1.0 * k)))
    found = [m for m in motions if m is not None]
    assert [m.t_from_ns for m in found[1:]] == [m.t_ns for m in found[:-1]]
    assert all(m.duration_s >= 0.5 for m in found)
    assert math.fsum(m.d_ne_m[0] for m in found) == pytest.approx(40.0, abs=1e-9)


def test_what_lasts_is_told_from_what_does_not() -> None:
    aiding = OdometryAiding()
    assert aiding.on_odometry(seen(0, 400, 4.0)) is None
    motion = aiding.on_odometry(seen(0, 600, 60.0, scale=0.02))
    assert motion is not None
    assert motion.sigma_scale == 0.02
    assert motion.cov_ne_m2[0][0] == pytest.approx(0.02, abs=2e-4)


def test_a_gap_gives_no_interval_and_the_next_one_begins_after_it() -> None:
    aiding = OdometryAiding()
    assert aiding.on_odometry(seen(0, 600, 6.0)) is not None
    assert aiding.on_odometry(seen(5000, 5200, 2.0)) is None
    motion = aiding.on_odometry(seen(5000, 5900, 9.0))
    assert motion is not None
    assert motion.t_from_ns >= 5000 * MS
    assert motion.d_ne_m[0] <= 9.0


def test_the_same_displacement_twice_is_used_once() -> None:
    aiding = OdometryAiding()
    assert aiding.on_odometry(seen(0, 600, 6.0)) is not None
    assert aiding.on_odometry(seen(0, 600, 6.0)) is None
