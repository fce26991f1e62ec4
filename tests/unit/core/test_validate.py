from __future__ import annotations

import math
from dataclasses import replace

import pytest

from visloc_companion.core.validate import fault, is_covariance, is_place, is_turn
from visloc_companion.errors import Reason
from visloc_companion.types import (
    Attitude,
    EstimatorStatus,
    Event,
    Fix,
    FrameRef,
    GeoPoint,
    Gnss,
    LocalPose,
    MapAtGnss,
    NoFix,
    Odometry,
    OpenPlace,
    OperatorFix,
    OriginChanged,
    PriorPose,
    Sun,
    Tick,
    TiltSeen,
    Turn,
)

NOW = 10**10
HERE = GeoPoint(59.0, 18.0, 50.0)
COV = ((1.0, 0.0), (0.0, 1.0))
NOWHERE = GeoPoint(math.nan, 18.0, 50.0)
Q = (1.0, 0.0, 0.0, 0.0)
STILL = (0.0, 0.0, 0.0)
NAN3 = (0.0, math.nan, 0.0)
FIX = Fix(NOW, NOW, 1, 1, "m", HERE, Q, ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.1, 0.01, 5.0)
GNSS = Gnss(NOW, NOW, 3, 12, HERE, 1.0, None, None)

SEEN = Odometry(NOW, NOW - 10**9, NOW, (3.0, 1.0, 0.0), ((0.04, 0.0), (0.0, 0.04)), 0.01, 0.02)

GOOD: list[Event] = [
    Attitude(NOW, NOW, Q, STILL),
    PriorPose(NOW, NOW, HERE, STILL, 10.0),
    LocalPose(NOW, NOW, STILL, STILL),
    GNSS,
    replace(GNSS, place=GeoPoint(0.0, 0.0, 0.0), fix_type=1),
    replace(GNSS, v_ned_mps=STILL),
    EstimatorStatus(NOW, None, 0.1, None, True, False, None),
    MapAtGnss(NOW, HERE, inside=True, surface_amsl_m=40.0),
    MapAtGnss(NOW, HERE, inside=True, surface_amsl_m=None),
    OriginChanged(NOW, HERE),
    OperatorFix(NOW, HERE, 20.0),
    FIX,
    SEEN,
    FrameRef(NOW, NOW, 1, 0, 640, 480, 1),
    Tick(NOW),
]
BAD: list[tuple[Event, Reason]] = [
    (replace(SEEN, displacement_ned_m=NAN3), Reason.NOT_FINITE),
    (replace(SEEN, cov_ne_m2=((0.0, 0.0), (0.0, 1.0))), Reason.NOT_FINITE),
    (replace(SEEN, sigma_scale=math.inf), Reason.NOT_FINITE),
    (replace(SEEN, per_focal_ne_m=(math.nan, 0.0)), Reason.NOT_FINITE),
    (replace(SEEN, t_from_ns=NOW), Reason.IMPLAUSIBLE_TIME),
    (replace(SEEN, t_to_ns=NOW + 10**9), Reason.IMPLAUSIBLE_TIME),
    (Attitude(NOW, NOW, (math.nan, 0.0, 0.0, 0.0), STILL), Reason.NOT_FINITE),
    (Attitude(NOW, NOW, Q, NAN3), Reason.NOT_FINITE),
    (PriorPose(NOW, NOW, NOWHERE, STILL, 10.0), Reason.NOT_FINITE),
    (PriorPose(NOW, NOW, GeoPoint(0.0, 0.0, 0.0), STILL, 10.0), Reason.NOT_FINITE),
    (PriorPose(NOW, NOW, HERE, (0.0, 300.0, 0.0), 10.0), Reason.NOT_FINITE),
    (PriorPose(NOW, NOW, HERE, STILL, math.inf), Reason.NOT_FINITE),
    (LocalPose(NOW, NOW, NAN3, STILL), Reason.NOT_FINITE),
    (PriorPose(NOW, NOW, HERE, STILL, -1e6), Reason.NOT_FINITE),
    (LocalPose(NOW, NOW, STILL, NAN3), Reason.NOT_FINITE),
    (LocalPose(NOW, NOW, (0.0, 0.0, 1e9), STILL), Reason.NOT_FINITE),
    (LocalPose(NOW, NOW, (0.0, -1e30, 0.0), STILL), Reason.NOT_FINITE),
    (replace(GNSS, h_acc_m=math.nan), Reason.NOT_FINITE),
    (replace(GNSS, place=NOWHERE), Reason.NOT_FINITE),
    (EstimatorStatus(NOW, math.nan, 0.1, None, True, False, None), Reason.NOT_FINITE),
    (MapAtGnss(NOW, HERE, inside=True, surface_amsl_m=math.nan), Reason.NOT_FINITE),
    (MapAtGnss(NOW, GeoPoint(59.0, 18.0, math.inf), inside=False, surface_amsl_m=None), Reason.NOT_FINITE),
    (OriginChanged(NOW, NOWHERE), Reason.NOT_FINITE),
    (OperatorFix(NOW, HERE, 0.0), Reason.NOT_FINITE),
    (OperatorFix(NOW, HERE, math.nan), Reason.NOT_FINITE),
    (replace(FIX, t_ns=NOW + 10**9), Reason.IMPLAUSIBLE_TIME),
    (replace(FIX, cov_ne_m2=((math.nan, 0.0), (0.0, 1.0))), Reason.NOT_FINITE),
    (replace(FIX, cov_ne_m2=((1.0, 2.0), (2.0, 1.0))), Reason.IMPLAUSIBLE_CLAIM),
    (replace(FIX, cov_ne_m2=((0.0, 0.0), (0.0, 0.0))), Reason.IMPLAUSIBLE_CLAIM),
    (replace(FIX, sigma_h_m=0.0), Reason.IMPLAUSIBLE_CLAIM),
    (replace(FIX, sigma_h_m=1e-12), Reason.IMPLAUSIBLE_CLAIM),
    (replace(FIX, sigma_h_m=1e9), Reason.IMPLAUSIBLE_CLAIM),
    (replace(FIX, per_focal_ne_m=(0.0, math.inf)), Reason.NOT_FINITE),
    (replace(FIX, probability_wrong=math.nan), Reason.NOT_FINITE),
    (replace(FIX, above_ground_m=math.nan), Reason.NOT_FINITE),
    (replace(FIX, footprint_m=math.inf), Reason.NOT_FINITE),
    (replace(FIX, footprint_m=-1.0), Reason.IMPLAUSIBLE_CLAIM),
    (replace(FIX, sun=Sun(math.nan, 30.0)), Reason.NOT_FINITE),
    (FrameRef(NOW, NOW + 10**9, 1, 0, 640, 480, 1), Reason.IMPLAUSIBLE_TIME),
]


@pytest.mark.parametrize("event", GOOD)
def test_good_events_pass(event: Event) -> None:
    assert fault(event, NOW) is None


@pytest.mark.parametrize(("event", "reason"), BAD)
def test_bad_events_have_a_reason(event: Event, reason: Reason) -> None:
    assert fault(event, NOW) is reason


def test_places() -> None:
    assert is_place(HERE)
    assert not is_place(GeoPoint(95.0, 0.0, 0.0))
    assert not is_place(GeoPoint(10.0, 190.0, 0.0))
    assert not is_place(GeoPoint(10.0, 10.0, 1e6))


def test_covariances() -> None:
    assert is_covariance(((1.0, 0.5), (0.5, 1.0)))
    assert not is_covariance(((1.0, 0.5), (0.4, 1.0)))
    assert not is_covariance(((0.0, 0.0), (0.0, 0.0)))
    assert not is_covariance(((math.inf, 0.0), (0.0, 1.0)))
    assert not is_covariance(((1e12, 0.0), (0.0, 1.0)))


TINY = ((1e-6, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 1e-6))
TURN = Turn(NOW - 10**9, NOW, Q, TINY)
FLAT = ((0.0, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 1e-6))
CROSSED = ((1e-6, 2e-6, 0.0), (2e-6, 1e-6, 0.0), (0.0, 0.0, 1e-6))


@pytest.mark.parametrize(
    "turn",
    [
        replace(TURN, q_from_to=(1.0, 0.0, math.nan, 0.0)),
        replace(TURN, q_from_to=(2.0, 0.0, 0.0, 0.0)),
        replace(TURN, t_from_ns=NOW),
        replace(TURN, cov_rad2=FLAT),
        replace(TURN, cov_rad2=CROSSED),
        replace(TURN, cov_rad2=((math.inf, 0.0, 0.0), *TINY[1:])),
    ],
)
def test_answers_with_a_turn_that_is_none_are_refused(turn: Turn) -> None:
    assert is_turn(TURN)
    assert not is_turn(turn)
    none = NoFix(NOW, NOW, 1, 1, "m", Reason.NO_MATCH, 5.0)
    for answer in (FIX, none):
        assert fault(replace(answer, turn=TURN), NOW) is None
        assert fault(replace(answer, turn=turn), NOW) is Reason.NOT_FINITE


def test_a_refusal_whose_fix_through_another_lens_is_none_is_refused() -> None:
    none = NoFix(NOW, NOW, 1, 1, "m", Reason.NO_MATCH, 5.0)
    assert fault(replace(none, zoomed=FIX), NOW) is None
    assert fault(replace(none, zoomed=replace(FIX, place=NOWHERE)), NOW) is Reason.NOT_FINITE


@pytest.mark.parametrize(
    ("place", "footprint_m", "reason"),
    [
        (OpenPlace(HERE, COV, -0.7), 60.0, None),
        (OpenPlace(HERE, COV, math.nan), 60.0, Reason.NOT_FINITE),
        (OpenPlace(GeoPoint(95.0, 0.0, 0.0), COV, -0.7), 60.0, Reason.NOT_FINITE),
        (OpenPlace(HERE, ((0.0, 0.0), (0.0, 0.0)), -0.7), 60.0, Reason.IMPLAUSIBLE_CLAIM),
        (OpenPlace(HERE, COV, 0.7), 60.0, Reason.IMPLAUSIBLE_CLAIM),
        (OpenPlace(HERE, COV, -0.7), 0.0, Reason.IMPLAUSIBLE_CLAIM),
        (OpenPlace(HERE, COV, -0.7), math.inf, Reason.NOT_FINITE),
    ],
)
def test_open_places_are_checked_as_fixes_are(place: OpenPlace, footprint_m: float, reason: Reason | None) -> None:
    answer = NoFix(NOW, NOW, 1, 1, "m", Reason.AMBIGUOUS, 5.0, open_places=(place,), footprint_m=footprint_m)
    assert fault(answer, NOW) is reason


@pytest.mark.parametrize(
    "tilt",
    [
        TiltSeen((math.nan, 0.0), ((1e-5, 0.0), (0.0, 1e-5))),
        TiltSeen((0.0, 0.0), ((1e-5, 0.0), (0.0, 0.0))),
        TiltSeen((0.0, 0.0), ((1e-5, 2e-5), (2e-5, 1e-5))),
        TiltSeen((0.0, 0.0), ((1e-5, 5e-6), (0.0, 1e-5))),
        TiltSeen((0.0, 0.0), ((math.inf, 0.0), (0.0, 1e-5))),
    ],
)
def test_fixes_with_a_tilt_that_is_none_are_refused(tilt: TiltSeen) -> None:
    assert fault(replace(FIX, tilt=TiltSeen((0.01, 0.0), ((1e-5, 1e-6), (1e-6, 1e-5)))), NOW) is None
    assert fault(replace(FIX, tilt=tilt), NOW) is Reason.NOT_FINITE
