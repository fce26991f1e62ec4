from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.localise.registry import make_localiser
from visloc_companion.localise.verify import beside_others, crowded
from visloc_companion.types import CameraModel, Fix, GeoPoint, NoFix

SIDE = 70
HOME, MODEL = GeoPoint(47.0, 8.0, 0.0), CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)


def paved(support, side=SIDE, size=500):
    """A flat map of 1 m pixels that is one square everywhere."""
    square = support.texture(3, side)
    n = size // side + 1
    pixels = np.tile(square, (n, n))[:size, :size]
    return support.FlatMap(pixels, np.full(pixels.shape, 100.0, np.float32))


def test_ground_that_repeats_itself_is_ambiguous_and_its_places_are_listed(support):
    world = paved(support)
    p = (3.0, -6.0, -170.0)
    pixels = support.render(world, MODEL, p, (0.0, 0.0, 0.3))
    request = support.request_at((8.0, -20.0, -170.0), (0.0, 0.0, 0.3), sigma_m=35.0)
    answer = make_localiser("gradient", MODEL).localise(request, pixels, world)
    assert isinstance(answer, NoFix)
    assert answer.reason is Reason.AMBIGUOUS
    shares = [math.exp(place.log_evidence) for place in answer.open_places]
    assert len(shares) >= 2
    assert sum(shares) <= 1.0
    assert shares == sorted(shares, reverse=True)
    assert shares[0] < 2 * shares[-1]  # copies are told apart by nothing
    for place in answer.open_places:
        off = np.array(ned_from_geo(place.place, HOME)[:2]) - p[:2]
        assert float(np.abs(off - SIDE * np.rint(off / SIDE)).max()) < 2.0
    assert answer.footprint_m == pytest.approx(70 * math.sqrt(160 * 120) / 140, rel=0.05)


def test_a_refusal_tells_where_the_search_left_the_place(support):
    """Its posterior spreads over the copies within the prior, and of a place of its own over a pixel or two."""
    world = paved(support)
    pixels = support.render(world, MODEL, (3.0, -6.0, -170.0), (0.0, 0.0, 0.3))
    request = support.request_at((8.0, -20.0, -170.0), (0.0, 0.0, 0.3), sigma_m=35.0)
    answer = make_localiser("gradient", MODEL).localise(request, pixels, world)
    told = dict(answer.evidence)
    modes = [(told[f"mode{k}_north_m"], told[f"mode{k}_east_m"], told[f"mode{k}_probability"]) for k in range(1, 5)]
    assert sum(share for *_, share in modes) < 0.95, "further copies hold the rest"
    for axis in ("north", "east"):
        assert SIDE / 2 < told[f"search_sigma_{axis}_m"] < 3 * 35.0
    assert told["search_entropy_nats"] > math.log(4)


def test_a_place_of_its_own_keeps_its_claim(flat, support):
    p = (3.0, -6.0, -170.0)
    pixels = support.render(flat, MODEL, p, (0.0, 0.0, 0.3))
    answer = make_localiser("gradient", MODEL).localise(support.request_at(p, (0.0, 0.0, 0.3)), pixels, flat)
    assert isinstance(answer, Fix)
    assert dict(answer.evidence)["share"] > 0.999
    told = dict(answer.evidence)
    assert math.hypot(told["search_north_m"], told["search_east_m"]) < 2.0
    assert max(told["search_sigma_north_m"], told["search_sigma_east_m"]) < 3.0


def test_a_match_keeps_its_place_in_the_search_under_a_tilt_that_is_not_known(flat, support):
    """The search looks with the prior's tilt, so its nadir lies a sixth of the footprint away from the refined one."""
    p, tilted = (3.0, -6.0, -270.0), (0.1, -0.09, 0.3)
    request = support.request_at(p, (0.0, 0.0, 0.3))
    request = replace(request, prior=replace(request.prior, sigma_tilt_rad=math.radians(6)))
    answer = make_localiser("gradient", MODEL, max_probability_wrong=1.0).localise(
        request, support.render(flat, MODEL, p, tilted), flat
    )
    assert isinstance(answer, Fix)
    evidence = dict(answer.evidence)
    nadir_m = math.hypot(evidence["mode1_north_m"], evidence["mode1_east_m"])
    assert nadir_m > 15.0
    assert evidence["mode_mass"] > 0.9
    assert evidence["share"] > 0.95
    assert evidence["runner_up"] < 1.0


def test_a_claim_is_no_better_than_the_share_of_all_places():
    assert beside_others(0.003, 0.25) == pytest.approx(0.75, abs=0.01)
    assert beside_others(0.003, 1.0) == pytest.approx(0.003)
    assert crowded(0.75, 0.25, 0.05) == (Reason.AMBIGUOUS, "one of several places, 75 % for the others")
    assert crowded(0.04, 0.97, 0.05) is None
