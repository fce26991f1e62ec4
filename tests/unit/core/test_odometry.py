from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from visloc_companion.core.odometry import ACCELERATION_MPS2, VELOCITY_MPS, OdometryTrack, Travelled
from visloc_companion.errors import Reason
from visloc_companion.types import Odometry, Rejected, TooOld

S = 1_000_000_000


def leg(start_s: float, end_s: float, north: float, east: float = 0.0, own: float = 0.1, scale=0.0, heading=0.0) -> Odometry:
    d = np.array([north, east])
    along, across = scale * d, heading * np.array([-east, north])
    cov = own**2 * np.eye(2) + np.outer(along, along) + np.outer(across, across)
    rows = ((float(cov[0, 0]), float(cov[0, 1])), (float(cov[1, 0]), float(cov[1, 1])))
    return Odometry(0, round(start_s * S), round(end_s * S), (north, east, 0.0), rows, scale, heading)


def track_of(*legs: Odometry) -> OdometryTrack:
    track = OdometryTrack()
    assert [track.add(item) for item in legs] == [None] * len(legs)
    return track


def between(track: OdometryTrack, start_s: float, end_s: float) -> Travelled:
    got = track.between(round(start_s * S), round(end_s * S))
    assert got is not None
    return got


def test_legs_add_up_own_errors_as_roots_and_shared_ones_with_the_distance() -> None:
    track = track_of(*(leg(k, k + 1, 30.0, own=0.2, scale=0.01, heading=0.02) for k in range(16)))
    got = between(track, 0, 16)
    assert got.displacement_ned_m == pytest.approx((480.0, 0.0, 0.0))
    assert got.path_m == pytest.approx(480.0)
    (nn, ne), (_, ee) = got.cov_ne_m2
    assert nn == pytest.approx(16 * 0.2**2 + 4.8**2)
    assert ee == pytest.approx(16 * 0.2**2 + 9.6**2)
    assert ne == pytest.approx(0.0)
    part = between(track, 4, 8)
    assert part.displacement_ned_m[0] == pytest.approx(120.0)
    assert part.cov_ne_m2[0][0] == pytest.approx(4 * 0.2**2 + 1.2**2)


def test_what_is_shared_cancels_on_the_way_back() -> None:
    square = [(50.0, 0.0), (0.0, 50.0), (-50.0, 0.0), (0.0, -50.0)]
    track = track_of(*(leg(k, k + 1, *d, own=0.1, scale=0.02, heading=0.05) for k, d in enumerate(square)))
    got = between(track, 0, 4)
    assert np.array(got.cov_ne_m2) == pytest.approx(4 * 0.1**2 * np.eye(2))
    assert got.path_m == pytest.approx(200.0)


def test_what_a_lens_makes_of_a_swing_ends_with_the_next_swing() -> None:
    there = replace(leg(0, 1, 10.0, own=0.1), sigma_focal=0.015, per_focal_ne_m=(0.0, 40.0), cov_ne_m2=((0.01, 0.0), (0.0, 0.37)))
    back = replace(leg(1, 2, 10.0, own=0.1), sigma_focal=0.015, per_focal_ne_m=(0.0, -40.0), cov_ne_m2=((0.01, 0.0), (0.0, 0.37)))
    track = track_of(there, back)
    half, whole = between(track, 0, 1), between(track, 0, 2)
    assert half.per_focal_ne_m == (0.0, 40.0)
    assert half.cov_ne_m2[1][1] == pytest.approx(0.1**2 + 0.6**2)
    assert half.own_ne_m2[1][1] == pytest.approx(0.1**2)
    assert whole.per_focal_ne_m == (0.0, 0.0)
    assert np.array(whole.cov_ne_m2) == pytest.approx(2 * 0.1**2 * np.eye(2))
    assert between(track, 0, 0.5).per_focal_ne_m == pytest.approx((0.0, 20.0))


def test_frames_of_one_leg_replace_each_other_and_do_not_pile_up() -> None:
    hover = track_of(*(leg(0, 0.1 * k, 0.3 * math.sin(k), own=0.05) for k in range(1, 200)))
    assert between(hover, 0, 19.9).cov_ne_m2[0][0] == pytest.approx(0.05**2)
    assert between(hover, 5.0, 19.9).cov_ne_m2[0][0] == pytest.approx(2 * 0.05**2)


@hypothesis_settings(max_examples=60)
@given(st.randoms(use_true_random=False), st.integers(2, 12))
def test_the_order_of_arrival_does_not_matter(random, n: int) -> None:
    legs = []
    for k in range(n):
        start = k if k % 4 else k + 0.3  # every fourth leaves a gap
        legs += [leg(start, k + 0.7, random.uniform(-9, 9), random.uniform(-9, 9), scale=0.01)]
        legs += [leg(start, k + 1, random.uniform(-9, 9), random.uniform(-9, 9), scale=0.01, heading=0.02)]
    mixed = list(legs)
    random.shuffle(mixed)
    one, other = track_of(*legs), track_of(*mixed)
    for start_s, end_s in ((0.3, n), (0.7, n - 0.5), (0.5, n + 3.0)):
        assert between(one, start_s, end_s) == between(other, start_s, end_s)


@hypothesis_settings(max_examples=60)
@given(
    st.lists(
        st.tuples(st.floats(-40, 40), st.floats(-40, 40), st.floats(0.0, 2.0), st.floats(0, 0.05), st.floats(0, 0.1)),
        min_size=1,
        max_size=12,
    ),
    st.floats(0, 1),
    st.floats(0, 1),
)
def test_covariances_are_covariances_and_displacements_add(legs, a: float, b: float) -> None:
    track = track_of(*(leg(k, k + 1, *values) for k, values in enumerate(legs)))
    first, second = sorted((a * (len(legs) + 2), b * (len(legs) + 2)))
    whole, parts = between(track, 0, second), (between(track, 0, first), between(track, first, second))
    for got in (whole, *parts):
        cov = np.array(got.cov_ne_m2)
        assert np.linalg.eigvalsh(cov).min() >= -1e-9 * (1 + np.trace(cov))
    for axis in range(3):
        total = parts[0].displacement_ned_m[axis] + parts[1].displacement_ned_m[axis]
        assert whole.displacement_ned_m[axis] == pytest.approx(total, abs=1e-9)


@hypothesis_settings(max_examples=40)
@given(st.integers(1, 20), st.floats(0.01, 1.0), st.floats(0.0, 0.03), st.floats(0.0, 0.05))
def test_on_a_straight_line_the_claim_only_grows(n: int, own: float, scale: float, heading: float) -> None:
    track = track_of(*(leg(k, k + 1, 20.0, 5.0, own, scale, heading) for k in range(n)))
    traces = [np.trace(np.array(between(track, 0, k).cov_ne_m2)) for k in range(n + 3)]
    assert all(later > earlier for earlier, later in pairwise(traces))


def test_over_a_gap_the_velocity_is_held_and_the_claim_grows_by_the_law() -> None:
    track = track_of(leg(0, 1, 10.0), leg(4, 5, 10.0))
    got = between(track, 0, 5)
    assert got.displacement_ned_m[0] == pytest.approx(50.0)
    assert got.unseen_s == pytest.approx(3.0)
    law = (3 * VELOCITY_MPS) ** 2 + (ACCELERATION_MPS2 * 9 / 2) ** 2
    assert got.cov_ne_m2[0][0] == pytest.approx(2 * 0.1**2 + law)
    late = between(track, 0, 7)
    assert (late.displacement_ned_m[0], late.unseen_s) == (pytest.approx(70.0), pytest.approx(5.0))


def test_a_leg_that_fills_the_gap_later_takes_its_claim_away() -> None:
    track = track_of(leg(0, 1, 10.0), leg(4, 5, 10.0))
    assert track.add(leg(1, 4, 33.0)) is None
    got = between(track, 0, 5)
    assert (got.displacement_ned_m[0], got.unseen_s) == (pytest.approx(53.0), 0.0)
    assert got.cov_ne_m2[0][0] == pytest.approx(3 * 0.1**2)


def test_times_between_frames_are_interpolated() -> None:
    track = track_of(leg(0, 2, 10.0), leg(2, 4, 30.0))
    got = between(track, 1.0, 3.0)
    assert got.displacement_ned_m[0] == pytest.approx(20.0)
    assert got.cov_ne_m2[0][0] > 0.1**2 / 4
    assert track.between(-S, 2 * S) is None
    assert OdometryTrack().between(0, S) is None
    with pytest.raises(ValueError, match="before"):
        track.between(2 * S, S)


def test_what_hangs_nowhere_and_what_is_known_changes_nothing() -> None:
    track = track_of(leg(0, 1, 10.0), leg(1, 2, 10.0))
    before = between(track, 0, 2)
    assert track.add(leg(0.5, 1.7, 99.0)) is None
    assert track.add(leg(1, 2, 10.0)) is None
    assert between(track, 0, 2) == before


def test_bad_displacements_are_refused_with_a_reason() -> None:
    good = leg(0, 1, 10.0)
    for bad, reason in (
        (replace(good, displacement_ned_m=(math.nan, 0.0, 0.0)), Reason.NOT_FINITE),
        (replace(good, sigma_scale=math.inf), Reason.NOT_FINITE),
        (replace(good, sigma_focal=math.nan), Reason.NOT_FINITE),
        (replace(good, per_focal_ne_m=(0.0, math.inf)), Reason.NOT_FINITE),
        (replace(good, t_to_ns=0), Reason.IMPLAUSIBLE_TIME),
        (replace(good, cov_ne_m2=((-1.0, 0.0), (0.0, 1.0))), Reason.BAD_INPUT),
        (replace(good, cov_ne_m2=((1.0, 2.0), (2.0, 1.0))), Reason.BAD_INPUT),
        (replace(good, cov_ne_m2=((1.0, 0.1), (0.0, 1.0))), Reason.BAD_INPUT),
        (replace(good, displacement_ned_m=(9000.0, 0.0, 0.0)), Reason.BAD_INPUT),
    ):
        answer = OdometryTrack().add(bad)
        assert isinstance(answer, Rejected)
        assert answer.reason is reason


def test_memory_is_bounded_and_legs_go_on() -> None:
    track = OdometryTrack(memory_s=10.0)
    for k in range(400):
        base = k // 20 * 20
        track.add(leg(0.1 * base, 0.1 * (k + 1), 0.5 * (k + 1 - base), own=0.1))
    assert len(track._nodes) < 130
    assert between(track, 35, 40).displacement_ned_m[0] == pytest.approx(25.0, abs=0.6)
    assert isinstance(track.add(leg(1, 2, 5.0)), TooOld)
    assert track.between(0, 40 * S) is None
    hover = OdometryTrack(memory_s=5.0)
    for k in range(1, 300):
        hover.add(leg(0, 0.1 * k, 0.1, own=0.1))
    assert len(hover._nodes) < 70
    assert between(hover, 0, 29.9).cov_ne_m2[0][0] == pytest.approx(0.1**2)


def test_a_displacement_that_ends_where_another_did_hangs_nowhere() -> None:
    """From a keyframe to a frame that was reached before: the way there stays what it was."""
    track = track_of(leg(0, 1, 10.0), leg(1, 2, 10.0), leg(0, 2, 26.0))
    assert between(track, 0, 2).displacement_ned_m == pytest.approx((20.0, 0.0, 0.0))


def test_ways_that_met_beyond_the_memory_have_met_at_the_earlier_of_what_is_left() -> None:
    """Two keyframes were seen from one that is forgotten; frames hang on each of them."""
    track = OdometryTrack(memory_s=4.0)
    for seen in (leg(0, 10, 100.0), leg(0, 11, 110.0, own=0.2), leg(10, 14, 40.0), leg(11, 15, 40.0)):
        track.add(seen)
    before = between(track, 14, 15)
    assert before.cov_ne_m2[0][0] == pytest.approx(3 * 0.1**2 + 0.2**2)
    for k in range(15, 18):
        track.add(leg(k, k + 1, 10.0))
    after = between(track, 14, 15)
    assert after.displacement_ned_m == pytest.approx(before.displacement_ned_m)
    assert after.cov_ne_m2[0][0] == pytest.approx(0.1**2 + 0.2**2)
