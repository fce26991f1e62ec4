"""Priors that lie: off by as much as is asked for in one thing, as claimed in the rest."""

from __future__ import annotations

import importlib
import math
from pathlib import Path

import pytest

from visloc_companion.evaluate.cases import Camera, Case, Truth
from visloc_companion.geo.se3 import angle_between, quat_from_euler
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.types import GeoPoint, PosePrior

ROOT = Path(__file__).resolve().parents[3]
PLACE = GeoPoint(47.0, 9.0, 300.0)
TRUTH = Truth(PLACE.lat_deg, PLACE.lon_deg, PLACE.h_amsl_m, 40.0, 1.0, True, 3.0, -2.0)
ELSEWHERE = PosePrior(GeoPoint(46.0, 9.0, 0.0), (1.0, 0.0, 0.0, 0.0), ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.1, 0.1)
CASE = Case("c", Path("f.png"), Path("o.tif"), None, Camera(200.0, 200.0, 127.5, 127.5, ()), ELSEWHERE)


@pytest.fixture
def lying(monkeypatch):
    """Of the benchmarks, which are no part of the installed package."""
    monkeypatch.syspath_prepend(str(ROOT))
    return importlib.import_module("benchmarks.false_tilt").lying


@pytest.mark.parametrize(
    ("what", "sigmas", "tilt_deg", "yaw_deg", "high_m"),
    [("tilt", 10, 5.0, None, None), ("yaw", 6, None, 15.0, None), ("height", 6, None, None, 18.0)],
)
def test_a_prior_lies_in_one_thing(lying, what, sigmas, tilt_deg, yaw_deg, high_m) -> None:
    prior = lying(CASE, TRUTH, 3, what, sigmas, 0.5).prior
    honest = lying(CASE, TRUTH, 3, "tilt", 0, 0.5).prior
    true = quat_from_euler(*(math.radians(a) for a in (3.0, -2.0, 40.0)))
    north, east, down = ned_from_geo(prior.place, PLACE)
    assert math.hypot(north, east) < 25.0
    assert prior.sigma_tilt_rad == pytest.approx(math.radians(0.5))
    if tilt_deg is not None:
        assert math.degrees(angle_between(prior.q_ned_frd, true)) >= tilt_deg
    if yaw_deg is not None:
        assert math.degrees(angle_between(prior.q_ned_frd, true)) == pytest.approx(yaw_deg, abs=0.3)
    if high_m is None:
        assert prior.place.h_amsl_m == honest.place.h_amsl_m
    else:
        assert -down == pytest.approx(high_m, abs=0.01)
