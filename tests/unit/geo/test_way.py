"""Points along a way."""

from __future__ import annotations

from itertools import pairwise

import pytest

from visloc_companion.geo.way import along
from visloc_companion.geo.wgs84 import distance_m
from visloc_companion.types import GeoPoint


def test_points_along_a_route() -> None:
    a, b = GeoPoint(47.0, 15.0, 0.0), GeoPoint(47.01, 15.0, 0.0)
    points = along([a, b, b], 100.0)
    assert points[0] == a and points[-1] == b
    steps = [distance_m(p, q) for p, q in pairwise(points)]
    assert max(steps) <= 100.0 and sum(steps) == pytest.approx(distance_m(b, a), rel=1e-6)
    assert along([a], 10.0) == [a]


def test_a_leg_has_no_more_points_than_are_asked_for() -> None:
    a, b = GeoPoint(47.0, 8.0, 500.0), GeoPoint(47.1, 8.0, 900.0)
    points = along([a, b], 1.0, 4)
    assert (len(points), points[0], points[-1]) == (5, a, b)
    assert [distance_m(point, a) for point in points] == pytest.approx([k * distance_m(b, a) / 4 for k in range(5)], abs=1.0)
