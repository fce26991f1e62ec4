"""Questions about the ground below the track, answered from a reference map: a fix near the truth, or the reason against it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.core.terrain.terrain_aiding import METHOD
from visloc_companion.errors import Reason
from visloc_companion.geo.wgs84 import geo_from_ned, ned_from_geo
from visloc_companion.localise.terrain.answer import answer_terrain
from visloc_companion.protocols import ReferenceMap
from visloc_companion.testing.fake_map import AnalyticMap
from visloc_companion.testing.hills import HillyMap
from visloc_companion.types import Fix, GeoPoint, NoFix, PosePrior, Sounding, TerrainRequest

ORIGIN = GeoPoint(47.0, 8.0, 400.0)
TRUTH = geo_from_ned((300.0, -200.0, -250.0), ORIGIN)
OFF_M = (40.0, -30.0, 0.0)


def question(ref: AnalyticMap, length_m: float = 2000.0, drift_mps: float = 0.3, final: bool = False) -> TerrainRequest:
    """A profile flown to the north-east at 25 m/s that ends at TRUTH, by dead reckoning that is off; the prior is 50 m away."""
    rng = np.random.default_rng(4)
    rows: list[Sounding] = []
    for age in np.arange(0.0, length_m / 25.0, 0.2)[::-1]:
        true = np.array([-age * 20.0, -age * 15.0])
        there = geo_from_ned((float(true[0]), float(true[1]), 0.0), TRUTH)
        up = ref.height_amsl_m(*ref.to_map(there.lat_deg, there.lon_deg)) - TRUTH.h_amsl_m + rng.normal(0, 0.3)
        rows.append((float(age), float(true[0] - drift_mps * age), float(true[1]), 0.0, 0.0, 0.0, float(up)))
    prior = PosePrior(geo_from_ned(OFF_M, TRUTH), (1.0, 0.0, 0.0, 0.0), ((1600.0, 0.0), (0.0, 1600.0)), 3.0, 0.05, 0.005)
    return TerrainRequest(7, 99, prior, 0.5, 0.005, 0.0, tuple(rows), final)


def asked(request: TerrainRequest, ref: ReferenceMap) -> Fix | NoFix:
    return answer_terrain(request, ref, 1.0, 0.05, 2000.0)


def reason_of(answer: Fix | NoFix) -> Reason:
    assert isinstance(answer, NoFix), answer
    assert (answer.method, answer.request_id, answer.t_ns) == (METHOD, 7, 99)
    return answer.reason


def test_a_profile_over_hills_is_found() -> None:
    hills = HillyMap(ORIGIN, 5000.0, 60.0)
    found = asked(question(hills), hills)
    assert isinstance(found, Fix), found
    north, east, down = ned_from_geo(found.place, TRUTH)
    assert np.hypot(north, east) < 8
    assert abs(down) < 1.5
    assert (found.method, found.request_id, found.t_ns) == (METHOD, 7, 99)
    assert found.cov_ne_m2[0][0] + found.cov_ne_m2[1][1] < 200
    assert found.probability_wrong <= 0.05


def test_even_ground_is_not_even_tried_before_the_stretch_is_as_long_as_it_may_be() -> None:
    even = HillyMap(ORIGIN, 5000.0, 0.5)
    early, late = asked(question(even), even), asked(question(even, final=True), even)
    assert reason_of(early) is Reason.LOW_TEXTURE
    assert isinstance(early, NoFix)
    assert "not enough yet" in early.detail
    assert reason_of(late) is Reason.LOW_TEXTURE
    assert isinstance(late, NoFix)
    assert "not enough yet" not in late.detail


def test_off_the_map_is_said() -> None:
    small = HillyMap(ORIGIN, 100.0, 60.0)
    request = question(HillyMap(ORIGIN, 5000.0, 60.0))
    assert reason_of(asked(request, small)) is Reason.OUTSIDE_MAP
    away = replace(request, prior=replace(request.prior, place=geo_from_ned((50_000.0, 0.0, 0.0), TRUTH)))
    assert reason_of(asked(away, small)) is Reason.OUTSIDE_MAP


def test_a_prior_without_coordinates_in_the_map_is_off_it(elsewhere: ReferenceMap) -> None:
    """It was `bad_input` with the text of an exception."""
    assert reason_of(asked(question(HillyMap(ORIGIN, 5000.0, 60.0)), elsewhere)) is Reason.OUTSIDE_MAP


@pytest.mark.parametrize("n", [0, 5])
def test_too_few_soundings_are_said(n: int) -> None:
    hills = HillyMap(ORIGIN, 5000.0, 60.0)
    request = question(hills, final=True)
    assert reason_of(asked(replace(request, soundings=request.soundings[:n]), hills)) is Reason.TOO_FEW_FEATURES


def test_other_hills_give_no_fix() -> None:
    assert isinstance(asked(question(HillyMap(ORIGIN, 5000.0, 60.0, seed=2), final=True), HillyMap(ORIGIN, 5000.0, 60.0)), NoFix)


def test_the_search_is_no_wider_than_it_may_be() -> None:
    hills = HillyMap(ORIGIN, 5000.0, 60.0)
    request = question(hills)
    wide = replace(request, prior=replace(request.prior, cov_ne_m2=((1e8, 0.0), (0.0, 1e8))))
    answer = answer_terrain(wide, hills, 1.0, 0.05, 200.0)
    assert isinstance(answer, Fix | NoFix)
    if isinstance(answer, Fix):
        assert np.hypot(*ned_from_geo(answer.place, TRUTH)[:2]) < 20
