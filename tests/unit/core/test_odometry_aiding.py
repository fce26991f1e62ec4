from __future__ import annotations

import math
from dataclasses import replace

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
            motions.append(aiding.on_odometry(seen(1000 * leg, 1000 * leg + 100 * k, 1.0 * k), inertial_mps2=None).of_filter)
    found = [m for m in motions if m is not None]
    assert [m.t_from_ns for m in found[1:]] == [m.t_ns for m in found[:-1]]
    assert all(m.duration_s >= 0.5 for m in found)
    assert math.fsum(m.d_ne_m[0] for m in found) == pytest.approx(40.0, abs=1e-9)


def test_what_lasts_is_told_from_what_does_not() -> None:
    aiding = OdometryAiding()
    assert aiding.on_odometry(seen(0, 400, 4.0), inertial_mps2=None).of_filter is None
    motion = aiding.on_odometry(seen(0, 600, 60.0, scale=0.02), inertial_mps2=None).of_filter
    assert motion is not None
    assert motion.sigma_scale == 0.02
    assert motion.cov_ne_m2[0][0] == pytest.approx(0.02, abs=2e-4)


def test_an_interval_says_what_a_wrong_lens_adds_to_it() -> None:
    aiding = OdometryAiding()
    aiding.on_odometry(replace(seen(0, 600, 6.0), sigma_focal=0.015, per_focal_ne_m=(20.0, 0.0)), inertial_mps2=None)
    motion = aiding.on_odometry(
        replace(seen(0, 1200, 12.0), sigma_focal=0.015, per_focal_ne_m=(25.0, 3.0)), inertial_mps2=None
    ).of_filter
    assert motion is not None
    assert (motion.sigma_focal, motion.per_focal_ne_m) == (0.015, (5.0, 3.0))


def test_a_gap_gives_no_interval_and_the_next_one_begins_after_it() -> None:
    aiding = OdometryAiding()
    assert aiding.on_odometry(seen(0, 600, 6.0), inertial_mps2=None).of_filter is not None
    assert aiding.on_odometry(seen(5000, 5200, 2.0), inertial_mps2=None).of_filter is None
    motion = aiding.on_odometry(seen(5000, 5900, 9.0), inertial_mps2=None).of_filter
    assert motion is not None
    assert motion.t_from_ns >= 5000 * MS
    assert motion.d_ne_m[0] <= 9.0


def test_the_same_displacement_twice_is_used_once() -> None:
    aiding = OdometryAiding()
    assert aiding.on_odometry(seen(0, 600, 6.0), inertial_mps2=None).of_filter is not None
    assert aiding.on_odometry(seen(0, 600, 6.0), inertial_mps2=None).of_filter is None


def intervals(own_m: float, inertial_mps2: float | None, seconds: int = 6) -> tuple[list[float], list[float]]:
    """Lengths (s) of the filter's and the monitor's intervals of one keyframe followed at 4 Hz, each frame good to `own_m`."""
    aiding, of_filter, of_monitor = OdometryAiding(), [], []
    for k in range(1, 4 * seconds + 1):
        cov = ((own_m**2, 0.0), (0.0, own_m**2))
        seen_ = Odometry(250 * k * MS, 0, 250 * k * MS, (2.5 * k, 0.0, 0.0), cov, 0.0, 0.0)
        found = aiding.on_odometry(seen_, inertial_mps2=inertial_mps2)
        of_filter += [] if found.of_filter is None else [found.of_filter.duration_s]
        of_monitor += [] if found.of_monitor is None else [found.of_monitor.duration_s]
    return of_filter, of_monitor


@pytest.mark.parametrize(
    ("own_m", "sigma_a_mps2", "lasts_s"),
    [(0.01, 0.05, 0.5), (0.04, 0.05, 1.0), (0.5, 0.05, 2.0), (0.17, 0.05, 2.0), (0.17, 0.3, 1.25)],
)
def test_uncertain_ends_make_longer_intervals_where_accelerations_carry(
    own_m: float, sigma_a_mps2: float, lasts_s: float
) -> None:
    """The better the accelerations, the longer."""
    of_filter, of_monitor = intervals(own_m, inertial_mps2=sigma_a_mps2)
    assert set(of_filter[1:]) == {lasts_s}
    assert set(of_monitor) == {0.5}
    assert set(intervals(own_m, inertial_mps2=None)[0]) == {0.5}


def test_what_was_seen_before_a_gap_is_told() -> None:
    aiding = OdometryAiding()
    wide = ((0.25, 0.0), (0.0, 0.25))
    for k in range(1, 5):
        seen_ = Odometry(250 * k * MS, 0, 250 * k * MS, (2.5 * k, 0.0, 0.0), wide, 0.0, 0.0)
        assert aiding.on_odometry(seen_, inertial_mps2=0.05).of_filter is None
    after = aiding.on_odometry(Odometry(1800 * MS, 1600 * MS, 1800 * MS, (2.0, 0.0, 0.0), wide, 0.0, 0.0), inertial_mps2=0.05)
    assert after.of_filter is not None
    assert (after.of_filter.t_from_ns, after.of_filter.t_ns) == (0, 1000 * MS)
    assert after.of_filter.d_ne_m[0] == pytest.approx(10.0)


def test_when_nothing_is_seen_any_more_nothing_waits() -> None:
    aiding, wide = OdometryAiding(), ((0.25, 0.0), (0.0, 0.25))
    assert aiding.lost() is None
    for k in range(1, 5):
        seen_ = Odometry(250 * k * MS, 0, 250 * k * MS, (2.5 * k, 0.0, 0.0), wide, 0.0, 0.0)
        assert aiding.on_odometry(seen_, inertial_mps2=0.05).of_filter is None
    rest = aiding.lost()
    assert rest is not None
    assert (rest.t_from_ns, rest.t_ns, rest.d_ne_m[0]) == (0, 1000 * MS, pytest.approx(10.0))
    assert aiding.lost() is None, "each stretch is told once"
