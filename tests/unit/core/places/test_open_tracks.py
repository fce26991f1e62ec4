from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.core.places.open_tracks import FEWEST_ANSWERS, OpenTracks
from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.types import Fix, FrameRef, GeoPoint, LocaliseRequest, NoFix, OpenPlace, PosePrior

ORIGIN = GeoPoint(47.0, 8.0, 400.0)
S, SIGMA_M, FOOTPRINT_M, V_MPS = 1_000_000_000, 40.0, 60.0, 10.0
COV = ((0.3, 0.0), (0.0, 0.3))


class Flight:
    """North at V_MPS from the origin, believed 20 m further east; `offsets` are listed beside the truth."""

    def __init__(self, v_mps=V_MPS):
        self.tracks, self.v_mps, self.t_s = OpenTracks(), v_mps, 0

    def on(self, seconds):
        for _ in range(10 * seconds + 1):
            self.tracks.moving(round(self.t_s * S), (self.v_mps, 0.0))
            self.t_s += 0.1
        self.t_s -= 0.1

    def see(self, offsets, shares=None, reason=Reason.AMBIGUOUS, believed_east_m=20.0, sigma_v_mps=0.3, ago_s=0.0):
        t_s = self.t_s - ago_s
        t_ns, number = round(t_s * S), round(t_s * 10)
        north = self.v_mps * t_s
        believed = wgs84.geo_from_ned((north, believed_east_m, -60.0), ORIGIN)
        prior = PosePrior(believed, (1.0, 0.0, 0.0, 0.0), ((SIGMA_M**2, 0.0), (0.0, SIGMA_M**2)), 3.0, 0.05, 0.02)
        self.tracks.asked(LocaliseRequest(number, FrameRef(t_ns, t_ns, 1, 0, 320, 240, 3), prior, 1))
        shares = shares or [0.98 / len(offsets)] * len(offsets)
        places = tuple(
            OpenPlace(wgs84.geo_from_ned((north + n, e, 0.0), ORIGIN), COV, math.log(share))
            for (n, e), share in zip(offsets, shares, strict=True)
        )
        answer = NoFix(t_ns, t_ns, number, 1, "deep", reason, 1.0, open_places=places, footprint_m=FOOTPRINT_M)
        return self.tracks.answered(answer, ORIGIN, sigma_v_mps)

    def off_m(self, fix):
        north, east, _ = wgs84.ned_from_geo(fix.place, ORIGIN)
        return math.hypot(north - self.v_mps * self.t_s, east)


TRUTH, LEFT, RIGHT, AHEAD = (0.0, 0.0), (0.0, -70.0), (0.0, 60.0), (80.0, 0.0)


def test_the_place_that_every_frame_shows_is_found():
    flight = Flight()
    for k, others in enumerate([[LEFT, RIGHT], [RIGHT, AHEAD], [LEFT], [AHEAD], [LEFT]]):
        flight.on(6)
        fix = flight.see([TRUTH, *others])
        assert fix is None or k + 1 >= FEWEST_ANSWERS
        if fix is not None:
            break
    assert isinstance(fix, Fix)
    assert flight.off_m(fix) < 3.0
    assert fix.probability_wrong <= 0.01
    assert fix.method == "deep"


@pytest.mark.parametrize("lattice_m", [25.0, 60.0])
def test_ground_that_repeats_itself_decides_nothing(lattice_m):
    rng = np.random.default_rng(1)
    lattice = [(n * lattice_m, e * lattice_m) for n in range(-1, 2) for e in range(-1, 2)]
    flight = Flight()
    for _ in range(30):
        flight.on(6)
        picked = [lattice[k] for k in rng.permutation(len(lattice))[:5]]
        shares = np.exp(rng.normal(0, 0.3, 5))
        shares *= 5 / len(lattice) / shares.sum()
        assert flight.see(picked, shares.tolist()) is None
    assert max(flight.tracks.weights) < 0.9


def test_all_of_a_lattice_listed_each_time_decides_nothing():
    flight = Flight()
    for k in range(30):
        flight.on(6)
        shares = [0.45, 0.25, 0.28] if k % 2 else [0.28, 0.45, 0.25]
        assert flight.see([TRUTH, LEFT, RIGHT], shares) is None
    assert len(flight.tracks.weights) == 3
    assert max(flight.tracks.weights) < 0.75  # what the prior makes of it


def test_frames_of_the_same_ground_count_once():
    hovering = Flight(v_mps=0.5)
    hovering.on(1)
    hovering.see([TRUTH, LEFT])
    before = hovering.tracks.weights
    for _ in range(20):
        hovering.on(1)
        assert hovering.see([TRUTH]) is None
    assert hovering.tracks.weights == before


def test_a_miss_counts_ten_to_one_and_over_half_new_ground_its_root():
    flight, ratios = Flight(), []
    for seconds, places in ((6, [TRUTH, RIGHT]), (3, [TRUTH]), (6, [TRUTH])):
        flight.on(seconds)
        flight.see(places)
        first, second, *_ = flight.tracks.weights
        ratios.append(first / second)
    assert ratios[1] / ratios[0] == pytest.approx(math.sqrt(10), rel=0.05)
    assert ratios[2] / ratios[1] == pytest.approx(10, rel=0.05)


def test_a_place_that_was_not_searched_is_not_missed():
    flight, ratios = Flight(), []
    for east_m in (20.0, -80.0):
        flight.on(6)
        flight.see([TRUTH, RIGHT] if east_m > 0 else [TRUTH], believed_east_m=east_m)
        first, second, *_ = flight.tracks.weights
        ratios.append(first / second)
    assert ratios[1] == pytest.approx(ratios[0], rel=0.01)


def test_nothing_is_said_where_one_place_or_another_reason_begins():
    flight = Flight()
    flight.on(6)
    flight.see([TRUTH])
    assert flight.tracks.weights == ()
    flight.see([TRUTH, LEFT], reason=Reason.NO_MATCH)
    assert flight.tracks.weights == ()
    flight.on(1)
    flight.see([TRUTH, LEFT])
    assert len(flight.tracks.weights) == 2


def test_a_frame_that_hardly_matches_anywhere_changes_hardly_anything():
    flight = Flight()
    flight.on(6)
    flight.see([TRUTH, LEFT])
    before = flight.tracks.weights
    flight.on(6)
    flight.see([TRUTH], [0.05], reason=Reason.NO_MATCH)
    assert flight.tracks.weights == pytest.approx(before, abs=0.12)


def test_old_hypotheses_and_another_origin_begin_anew():
    flight = Flight()
    flight.on(6)
    flight.see([TRUTH, LEFT])
    flight.on(35)
    flight.see([TRUTH])
    assert flight.tracks.weights == ()


def test_an_answer_of_an_older_frame_than_the_last_that_counted_says_nothing():
    flight = Flight()
    flight.on(12)
    flight.see([TRUTH, LEFT])
    before = flight.tracks.weights
    for ago_s in (0.0, 7.0):
        flight.see([TRUTH], ago_s=ago_s)
        assert flight.tracks.weights == before
    flight.on(6)
    flight.see([TRUTH])
    assert flight.tracks.weights != before


def test_places_that_a_velocity_carried_further_than_they_lie_apart_are_given_up():
    """After 20 s by a velocity that is known to 3 m/s any of them may be any place; the next answer begins anew."""
    flight = Flight()
    flight.on(6)
    flight.see([TRUTH, LEFT], sigma_v_mps=3.0)
    flight.on(20)
    assert flight.see([TRUTH], sigma_v_mps=3.0) is None
    assert flight.tracks.weights == ()
    flight.on(6)
    flight.see([TRUTH, RIGHT, AHEAD])
    assert len(flight.tracks.weights) == 3


def test_no_more_than_eight_are_kept():
    flight = Flight()
    rng = np.random.default_rng(3)
    for _ in range(8):
        flight.on(6)
        flight.see([(float(n), float(e)) for n, e in rng.uniform(-90, 90, (5, 2))])
    assert 0 < len(flight.tracks.weights) <= 8
    assert sum(flight.tracks.weights) <= 1.0
