"""Views that lean over woods, and fixes of them against the truth."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks.leaning import ABOVE_M, GSD_M, HEIGHT_M, PRIOR_M, cells, judged, request_of, views
from visloc_companion.geo.se3 import R_from_quat
from visloc_companion.geo.wgs84 import geo_from_ned, ned_from_geo
from visloc_companion.sim.scene import Scene
from visloc_companion.types import Fix, GeoPoint

LARGEST_DEG = 35.0
SIZE = 1400
T_MAP_PIX = np.array([[GSD_M, 0.0, 605000.0], [0.0, -GSD_M, 5349000.0]])


def test_every_other_view_is_of_a_wood() -> None:
    scene = Scene(np.zeros((SIZE, SIZE, 3), np.uint8), np.zeros((SIZE, SIZE), np.float32), T_MAP_PIX, "EPSG:32632")
    ground, stands = np.full((SIZE, SIZE), 400, np.float32), np.zeros((SIZE, SIZE), np.float32)
    stands[:, : SIZE // 3] = 12.0
    found = list(views(scene, ground, stands, np.random.default_rng(1), 30, LARGEST_DEG))
    assert len(found) == 30
    assert 15 <= sum(wooded for *_, wooded in found) < 30
    for place, q, tilt_deg, _ in found:
        assert ABOVE_M[0] <= place.h_amsl_m - 400 <= ABOVE_M[1]
        assert math.degrees(math.acos(R_from_quat(q)[2, 2])) == pytest.approx(tilt_deg, abs=2.0)
        assert tilt_deg <= LARGEST_DEG


def test_the_prior_errs_as_it_says() -> None:
    view, rng = (GeoPoint(47.0, 8.0, 500.0), (1.0, 0.0, 0.0, 0.0), 0.0, False), np.random.default_rng(2)
    priors = [request_of(view, k, rng, 0.01).prior for k in range(300)]
    off = np.array([ned_from_geo(prior.place, view[0]) for prior in priors])
    assert off.std(axis=0) == pytest.approx([PRIOR_M, PRIOR_M, HEIGHT_M], rel=0.15)


def test_figures_of_fixes() -> None:
    rng, view, rows = np.random.default_rng(3), (GeoPoint(47.0, 8.0, 500.0), (1.0, 0.0, 0.0, 0.0), 20.0, True), []
    for _ in range(400):
        place = geo_from_ned((float(rng.normal(0, 2)), float(rng.normal(0, 1)), float(rng.normal(0, 0.5))), view[0])
        cov = ((4.0, 0.0), (0.0, 1.0))
        rows.append(judged(Fix(0, 0, 0, 0, "deep", place, view[1], cov, 0.25, 0.01, 0.0, 0.0), view))
    n, rms, _, _, height, over, over_height, inside = cells(np.array(rows))
    assert n == "400"
    assert float(rms) == pytest.approx(math.sqrt(5), abs=0.15)
    assert (float(height), float(over), float(over_height)) == pytest.approx((0.5, 1.0, 2.0), rel=0.1)
    assert float(inside[:-2]) == pytest.approx(95.0, abs=3.0)
    assert rows[0][-2:] == (20.0, True)
