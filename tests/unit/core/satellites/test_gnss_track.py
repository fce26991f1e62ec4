"""The receiver's positions as a track, and beside a fix."""

from __future__ import annotations

import pytest

from visloc_companion.core.satellites.gnss_track import GnssTrack
from visloc_companion.geo import wgs84
from visloc_companion.types import Fix, GeoPoint

S = 1_000_000_000
HERE = GeoPoint(59.3, 18.1, 40.0)


def at(north_m: float) -> GeoPoint:
    return wgs84.geo_from_ned((north_m, 0.0, 0.0), HERE)


def fix(t_s: float, north_m: float) -> Fix:
    t, cov = round(t_s * S), ((1.0, 0.0), (0.0, 1.0))
    return Fix(t, t, 1, 1, "t", at(north_m), (1.0, 0.0, 0.0, 0.0), cov, 1.0, 0.1, 0.0, 1.0)


def track(*points: tuple[float, float]) -> GnssTrack:
    got = GnssTrack()
    for t_s, north_m in points:
        got.add(round(t_s * S), wgs84.geo_from_ned((north_m, 0.0, 0.0), HERE))
    return got


def test_displacements_are_interpolated_between_positions() -> None:
    got = track((1.0, 0.0), (2.0, 10.0), (3.0, 20.0), (2.5, 999.0))
    assert got.newest_ns == 3 * S
    assert got.displacement(round(1.5 * S), round(2.7 * S)) == pytest.approx((12.0, 0.0), abs=1e-3)
    assert got.displacement(S, 3 * S) == pytest.approx((20.0, 0.0), abs=1e-3)
    assert got.displacement(0, 2 * S) is None
    assert got.displacement(S, 4 * S) is None


def test_holes_are_not_interpolated_and_old_positions_go() -> None:
    assert track((1.0, 0.0), (5.0, 40.0)).displacement(2 * S, 5 * S) is None
    long = track(*((float(k), 10.0 * k) for k in range(40)))
    assert long.displacement(2 * S, 30 * S) is None


def test_no_displacement_reaches_over_a_lost_fix() -> None:
    got = track((1.0, 0.0), (2.0, 10.0))
    got.interrupted()
    assert got.newest_ns is None
    assert got.newest == at(10.0)
    got.add(3 * S, at(20.0))
    got.add(4 * S, at(30.0))
    assert got.newest_ns == 4 * S
    assert got.displacement(S, 3 * S) is None
    assert got.displacement(S, round(2.5 * S)) is None
    assert got.displacement(3 * S, 4 * S) == pytest.approx((10.0, 0.0), abs=1e-3)


def test_without_a_position_there_is_nothing_to_compare() -> None:
    got = GnssTrack()
    assert got.newest is None
    assert got.newest_ns is None
    assert got.displacement(0, S) is None
    assert got.minus(fix(0.0, 0.0), (0.0, 0.0, 0.0)) is None


def test_gnss_minus_a_fix_at_image_time() -> None:
    got = track(*((float(k), 10.0 * k + 7.0) for k in range(5)), (2.0, 999.0))
    north = (10.0, 0.0, 0.0)
    assert got.minus(fix(1.5, 15.0), north) == pytest.approx((7.0, 0.0), abs=1e-3)
    assert got.minus(fix(4.5, 45.0), north) == pytest.approx((7.0, 0.0), abs=1e-3)
    assert got.minus(fix(-0.5, -5.0), north) == pytest.approx((7.0, 0.0), abs=1e-3)
    assert got.minus(fix(9.0, 90.0), north) is None
    got.add(100 * S, at(0.0))
    assert got.minus(fix(2.0, 20.0), north) is None


def test_a_position_is_not_carried_on_when_the_receiver_has_lost_its_fix() -> None:
    """A plane in a turn is 10 m away from where its velocity would have led it."""
    got = track(*((k / 5, 4.0 * k) for k in range(21)))
    north = (20.0, 0.0, 0.0)
    assert got.minus(fix(4.2, 84.0), north) == pytest.approx((0.0, 0.0), abs=1e-3)
    got.interrupted()
    assert got.minus(fix(3.9, 78.0), north) == pytest.approx((0.0, 0.0), abs=1e-3)
    assert got.minus(fix(4.2, 84.0), north) is None
    got.add(round(5.8 * S), at(116.0))
    assert got.minus(fix(4.9, 98.0), north) is None
    assert got.minus(fix(5.8, 116.0), north) == pytest.approx((0.0, 0.0), abs=1e-3)


def test_a_position_is_not_carried_on_when_the_next_one_does_not_come() -> None:
    got = track(*((k / 5, 4.0 * k) for k in range(21)))
    assert got.minus(fix(4.3, 86.0), (20.0, 0.0, 0.0)) is not None
    assert got.minus(fix(4.5, 90.0), (20.0, 0.0, 0.0)) is None


def test_a_lost_fix_that_is_back_at_once_leaves_no_hole() -> None:
    got = track((1.0, 20.0), (1.2, 24.0))
    got.interrupted()
    got.add(round(1.6 * S), at(32.0))
    assert got.minus(fix(1.4, 28.0), (20.0, 0.0, 0.0)) == pytest.approx((0.0, 0.0), abs=1e-3)
