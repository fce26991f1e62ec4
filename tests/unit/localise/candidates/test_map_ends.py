"""A square of the map is searched and no more of it, and its answer tells at which sides the map goes on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.geo.wgs84 import distance_m, geo_from_ned
from visloc_companion.localise.candidates.hypotheses import search_box
from visloc_companion.localise.plan import SearchPlan, make_plan
from visloc_companion.localise.registry import make_localiser
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.types import MAP_SIDES, CameraModel, Fix, LocaliseRequest, NoFix

MODEL = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)
LEVEL, UP_M = (0.0, 0.0, 0.6), -235.0


def asked(support, place_ne_m: tuple[float, float], within_m: float | None, sigma_m: float = 60.0) -> LocaliseRequest:
    request = support.request_at((*place_ne_m, UP_M), LEVEL, sigma_m=sigma_m)
    return replace(request, prior=replace(request.prior, within_m=within_m))


def answered(ref, support, truth_ne_m: tuple[float, float], request: LocaliseRequest) -> Fix | NoFix:
    frame = support.render(ref, MODEL, (*truth_ne_m, UP_M), LEVEL)
    return make_localiser("gradient", MODEL).localise(request, frame, ref)


def test_what_lies_beyond_the_square_is_not_found(flat, support):
    truth = 95.0, -20.0
    place = geo_from_ned((*truth, UP_M), support.HOME)
    for within_m, found in ((None, True), (110.0, True), (80.0, False)):
        answer = answered(flat, support, truth, asked(support, (0.0, 0.0), within_m, 50.0))
        assert (isinstance(answer, Fix) and distance_m(answer.place, place) < 3.0) is found


def test_a_square_costs_less_than_the_circle_about_it(flat, support):
    sides = []
    for within_m in (None, 80.0):
        plan = make_plan(asked(support, (0.0, 0.0), within_m, 40.0).prior, MODEL, flat, LocaliserSettings())
        assert isinstance(plan, SearchPlan)
        low, high = search_box(plan)
        sides.append(float((high - low).max()))
    assert sides[0] - sides[1] == pytest.approx(2 * (120.0 - 80.0), abs=3.0)


def test_an_answer_tells_at_which_sides_of_the_square_there_is_map(flat, support):
    """It reaches 250 m to every side of its middle."""
    known = np.ones(flat.pixels.shape, np.bool_)
    known[:, 300:] = False  # 50 m east of the middle
    gap = support.FlatMap(flat.pixels, flat.surface, known=known)
    for ref, place, ends in (
        (flat, (0.0, 0.0), set()),
        (flat, (180.0, 0.0), {"map_north"}),
        (flat, (-180.0, -190.0), {"map_south", "map_west"}),
        (gap, (0.0, 0.0), {"map_east"}),
    ):
        told = dict(answered(ref, support, place, asked(support, place, 80.0)).evidence)
        assert {name for name in MAP_SIDES if told[name] == 0.0} == ends
        assert all(0.4 < told[name] <= 1.0 for name in MAP_SIDES if name not in ends)
    stranger = support.FlatMap(support.texture(9), flat.surface)
    frame = support.render(stranger, MODEL, (0.0, 0.0, UP_M), LEVEL)
    nothing = make_localiser("gradient", MODEL).localise(asked(support, (180.0, 0.0), 80.0), frame, flat)
    assert isinstance(nothing, NoFix)
    assert {name for name in MAP_SIDES if dict(nothing.evidence)[name] == 0.0} == {"map_north"}


@pytest.mark.parametrize("within_m", [None, 2500.0])
def test_of_what_is_no_square_nothing_is_told(within_m: float | None, flat, support):
    """None was asked for, or less of it is searched."""
    answer = answered(flat, support, (0.0, 0.0), asked(support, (0.0, 0.0), within_m))
    assert not set(MAP_SIDES) & dict(answer.evidence).keys()
