from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from visloc_companion.core.estimator import PositionFilter
from visloc_companion.core.filter import fusion
from visloc_companion.core.filter.belief import seeded
from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.propagation import Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.core.velocity.air_velocity import AirError, AirVelocity
from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.protocols import Estimator
from visloc_companion.types import Accepted, Fix, GeoPoint, NavState, Rejected, TooOld

ORIGIN = GeoPoint(47.4, 8.5, 400.0)
SETTINGS = NavigatorSettings()
S = 1_000_000_000


def velocity(t_s: float, north: float = 10.0, east: float = 0.0, down: float = 0.0, h_m: float = 500.0) -> Velocity:
    return Velocity(round(t_s * S), (north, east, down), h_m, 0.3, Drive.AUTOPILOT)


def fix(t_s: float, north: float, east: float, frame_id: int = 1, sigma: float = 1.0) -> Fix:
    place = wgs84.geo_from_ned((north, east, -102.0), ORIGIN)
    t_ns = round(t_s * S)
    cov = ((sigma**2, 0.0), (0.0, sigma**2))
    return Fix(t_ns, t_ns, 1, frame_id, "test", place, (1.0, 0.0, 0.0, 0.0), cov, 1.0, 0.1, 0.001, 5.0)


def made(sigma_m: float = 2.0) -> PositionFilter:
    start = seeded(0, (0.0, 0.0), sigma_m, 0.3, Drive.AUTOPILOT, SETTINGS)
    return PositionFilter(SETTINGS, ORIGIN, start, velocity(0.0))


def states(kalman_filter: PositionFilter) -> np.ndarray:
    def row(s: NavState) -> list[float]:
        return [*s.p_ned_m, *s.v_ned_mps, *s.cov_ne_m2[0], *s.cov_ne_m2[1], s.age_of_fix_s]

    return np.array([row(kalman_filter.at(round(t * S))) for t in np.arange(0.5, 6.5, 0.37)])


def test_asking_in_between_changes_nothing() -> None:
    """What comes in is folded when it is asked for: the same numbers, whether that is at once or at the end."""
    asked, left_alone = made(), made()
    for k in range(1, 20):
        for each in (asked, left_alone):
            each.drive(velocity(0.25 * k, 10.0 + 0.1 * k))
            each.observe(fix(0.25 * k - 0.4, 2.5 * k - 4.0, 0.1, frame_id=k))
        asked.at(round(0.25 * k * S)), asked.protection_level_m(round((0.25 * k - 0.3) * S))
    np.testing.assert_array_equal(states(asked), states(left_alone))
    assert asked.protection_level_m(5 * S) == left_alone.protection_level_m(5 * S)


def test_what_a_belief_rests_on_is_known_before_velocities_are_folded(monkeypatch: pytest.MonkeyPatch) -> None:
    kalman_filter = made()
    for k in range(1, 5):
        kalman_filter.drive(velocity(0.25 * k))
    assert isinstance(kalman_filter.observe(fix(0.3, 3.0, 0.0)), Accepted)
    with monkeypatch.context() as nothing_folded:
        nothing_folded.delattr(fusion, "propagated")
        rests = kalman_filter.rests
    newest = kalman_filter.newest
    assert (rests.last_fix_ns, rests.started_ns) == (newest.last_fix_ns, newest.started_ns) == (round(0.3 * S), 0)
    assert kalman_filter.rests is newest, "where it is folded already"


def test_is_an_estimator() -> None:
    estimator: Estimator = made()
    assert isinstance(estimator.observe(fix(0.0, 0.0, 0.0)), Accepted)


@hypothesis_settings(max_examples=60)
@given(st.permutations(range(16)), st.integers(0, 10_000))
def test_late_fixes_give_the_state_of_those_in_order(order: list[int], seed: int) -> None:
    """Ten fixes, among them outliers that agree (so that the filter restarts), arriving in any order among the velocities."""
    rng = np.random.default_rng(seed)
    speeds = [velocity(0.5 * k, 10 + float(rng.normal()), float(rng.normal())) for k in range(1, 12)]
    fixes = []
    for k, t in enumerate(np.sort(rng.uniform(0.1, 5.5, 16))):
        off = 200.0 if rng.random() < 0.6 else 0.0
        fixes.append(fix(float(t), 10 * float(t) + float(rng.normal()) + off, float(rng.normal()), frame_id=k))
    in_order, late = made(), made()
    for item in sorted([*speeds, *fixes], key=lambda item: item.t_ns):
        in_order.drive(item) if isinstance(item, Velocity) else in_order.observe(item)
    arrivals: list[Velocity | Fix] = [fixes[k] for k in order]
    for k, speed in enumerate(speeds):
        arrivals.insert(int(rng.integers(0 if k == 0 else arrivals.index(speeds[k - 1]) + 1, len(arrivals) + 1)), speed)
    for item in arrivals:
        late.drive(item) if isinstance(item, Velocity) else late.observe(item)
    np.testing.assert_allclose(states(late), states(in_order), rtol=0, atol=1e-9)
    assert late.newest.started_ns == in_order.newest.started_ns


def test_velocity_is_interpolated_between_samples_and_held_after_the_last() -> None:
    kalman_filter = made()
    kalman_filter.drive(velocity(1.0, north=20.0))
    assert kalman_filter.at(S // 2).p_ned_m[0] == pytest.approx((10 + 15) / 2 * 0.5)
    assert kalman_filter.at(S).p_ned_m[0] == pytest.approx(15.0)
    assert kalman_filter.at(S + S // 2).p_ned_m[0] == pytest.approx(15.0 + 10.0)
    assert kalman_filter.at(S + S // 2).v_ned_mps[0] == pytest.approx(20.0)


def test_output_keeps_what_fixes_have_in_common_however_many_came() -> None:
    """The map's error, and what lasts of their own (1 m) for as long as hardly any way is gone."""
    kalman_filter = made()
    for k in range(1, 200):
        kalman_filter.drive(velocity(0.02 * k))
        kalman_filter.observe(fix(0.02 * k, 0.2 * k, 0.0, k))
    state = kalman_filter.at(4 * S)
    least_m = math.hypot(SETTINGS.map_sigma_m, math.sqrt(0.5))
    assert 0.97 * least_m < math.sqrt(state.cov_ne_m2[0][0]) < 1.1 * least_m
    assert kalman_filter.protection_level_m(4 * S) > 4.8 * least_m
    after_one = made()
    after_one.drive(velocity(0.02))
    after_one.observe(fix(0.02, 0.2, 0.0, 1))
    assert state.age_of_fix_s == pytest.approx(0.02)


def test_what_is_older_than_the_memory_is_too_old() -> None:
    kalman_filter = made()
    for k in range(1, 101):
        kalman_filter.drive(velocity(0.1 * k))
    outcome = kalman_filter.observe(fix(2.0, 20.0, 0.0))
    assert isinstance(outcome, TooOld)
    assert outcome.age_s == pytest.approx(8.0)
    before = kalman_filter.at(10 * S)
    kalman_filter.drive(velocity(2.05, north=99.0))
    assert kalman_filter.at(10 * S) == before
    assert isinstance(kalman_filter.observe(fix(6.0, 60.0, 0.0)), Accepted)


def test_a_lone_input_far_ahead_still_has_its_outcome() -> None:
    kalman_filter = made()
    assert isinstance(kalman_filter.observe(fix(30.0, 300.0, 0.0)), Accepted)


def test_gate() -> None:
    kalman_filter = made()
    outcome = kalman_filter.observe(fix(0.0, 100.0, 0.0))
    assert isinstance(outcome, Rejected)
    assert outcome.reason is Reason.GATED
    assert outcome.nis == pytest.approx(100**2 / (4 + 1 + 0.25))


def test_what_a_velocity_is_known_to_err_by_is_not_taken_off_the_one_that_follows_it_over_a_gap() -> None:
    """An integrated velocity was known to be 3.7 m/s off; a copter that flew straight on through 4 s was sent 13 m off."""
    flying = made()
    for k in range(1, 81):
        flying.drive(replace(velocity(k / 4, 13.0), drive=Drive.INERTIAL, sigma_a_mps2=0.1))
        flying.observe(fix(k / 4, 10.0 * k / 4, 0.0))
    assert flying.at(20 * S).v_ned_mps[0] == pytest.approx(10.0, abs=0.3)
    flying.drive(replace(velocity(24.0, 10.0), drive=Drive.FED_BACK))
    assert flying.at(24 * S).p_ned_m[0] == pytest.approx(240.0, abs=2.0)


def test_a_gap_in_the_velocity_blurs_the_position() -> None:
    steady, gappy = made(), made()
    for k in range(1, 51):
        steady.drive(velocity(0.1 * k))
    gappy.drive(velocity(5.0))
    assert gappy.at(5 * S).cov_ne_m2[0][0] > steady.at(5 * S).cov_ne_m2[0][0] + 200
    assert steady.at(9 * S).cov_ne_m2[0][0] > steady.at(5 * S).cov_ne_m2[0][0] + 100


def test_a_velocity_that_is_overdue_claims_more_by_the_tick() -> None:
    """A plane that turned was 4.4 m off within a second of silence, with 1.6 m claimed, and 3 m more a tick later."""
    steady, silent = made(), made()
    for k in range(1, 81):
        steady.drive(velocity(0.1 * k))
        if k <= 50:
            silent.drive(velocity(0.1 * k))

    def more_m(age_s: float) -> float:
        t_ns = round((5.0 + age_s) * S)
        return math.sqrt(silent.at(t_ns).cov_ne_m2[0][0] - steady.at(t_ns).cov_ne_m2[0][0])

    assert silent.at(S * 21 // 4).cov_ne_m2[0][0] == pytest.approx(steady.at(S * 21 // 4).cov_ne_m2[0][0])
    for age_s in (0.3, 0.5, 0.9, 1.0, 1.01):
        assert more_m(age_s) == pytest.approx(3.0 * age_s**2, rel=0.02)
    for flying in (steady, silent):
        flying.observe(fix(5.5, 55.0, 0.0))  # what comes meanwhile takes away none of what is claimed from then on
    assert more_m(1.0) > 3.0 * (1.0 - 0.5**2)
    silent.drive(velocity(5.9))
    assert silent.at(S * 59 // 10).cov_ne_m2[0][0] == pytest.approx(steady.at(S * 59 // 10).cov_ne_m2[0][0], rel=0.02)


def test_frames_that_were_taken_at_another_time_leave_the_position_open_along_the_way() -> None:
    kalman_filter = made()
    for k in range(1, 9):
        kalman_filter.drive(velocity(0.25 * k, 6.0, 8.0))
    (nn, _), (_, ee) = kalman_filter.at(2 * S).cov_ne_m2
    level_m = kalman_filter.protection_level_m(2 * S)
    kalman_filter.retimed(-1.5)
    (wide_nn, wide_ne), (_, wide_ee) = kalman_filter.at(2 * S).cov_ne_m2
    assert (wide_nn - nn, wide_ne, wide_ee - ee) == pytest.approx((9.0**2, 9.0 * 12.0, 12.0**2), rel=0.01)
    assert kalman_filter.protection_level_m(2 * S) > level_m + 45.0


def test_height_is_the_autopilots_and_follows_its_climb() -> None:
    kalman_filter = made()
    kalman_filter.drive(velocity(1.0, down=-2.0, h_m=502.0))
    assert kalman_filter.at(S // 2).p_ned_m[2] == pytest.approx(-101.0)
    assert kalman_filter.at(S + S // 2).p_ned_m[2] == pytest.approx(-103.0)
    assert kalman_filter.at(9 * S).p_ned_m[2] == pytest.approx(-104.0)  # held for a second at most


def test_trusted_gnss_moves_the_state_but_is_no_fix() -> None:
    kalman_filter = made(sigma_m=10.0)
    assert isinstance(kalman_filter.observe_gnss(0, wgs84.geo_from_ned((8.0, 0.0, 0.0), ORIGIN), 2.0), Accepted)
    state = kalman_filter.at(S)
    assert state.p_ned_m[0] == pytest.approx(10 + 8 * 100 / 104, abs=0.1)
    assert state.age_of_fix_s == pytest.approx(1.0)  # since the seed


def test_a_moved_origin_leaves_the_vehicle_where_it_is() -> None:
    moved = wgs84.geo_from_ned((1000.0, -500.0, -20.0), ORIGIN)
    plain, other = made(), made()
    for kalman_filter in (plain, other):
        for k in range(1, 31):
            kalman_filter.drive(velocity(0.1 * k))
        kalman_filter.observe(fix(2.0, 21.0, 1.0))
        kalman_filter.observe(fix(2.2, 400.0, 1.0))
    other.move_origin(moved)
    for kalman_filter in (plain, other):
        kalman_filter.observe(fix(1.5, 15.5, 0.5))  # rewinds through the move
        kalman_filter.drive(velocity(3.1))
    a = wgs84.geo_from_ned(plain.at(3 * S).p_ned_m, ORIGIN)
    b = wgs84.geo_from_ned(other.at(3 * S).p_ned_m, moved)
    assert wgs84.distance_m(a, b) < 0.01
    assert b.h_amsl_m == pytest.approx(a.h_amsl_m)
    assert other.newest.rejected[0].anchor_ne_m[0] == pytest.approx(plain.newest.rejected[0].anchor_ne_m[0] - 1000, abs=0.2)


@pytest.mark.parametrize("moved_m", [0.0, 5000.0])
def test_a_frozen_camera_is_not_believed_because_the_origin_moved(moved_m: float) -> None:
    kalman_filter = made()
    for k in range(1, 200):
        kalman_filter.drive(velocity(0.1 * k))
        if k == 170:
            kalman_filter.move_origin(wgs84.geo_from_ned((moved_m, 0.0, 0.0), ORIGIN))
        if k >= 110 and k % 10 == 0:
            assert isinstance(kalman_filter.observe(fix(0.1 * k, 0.0, 0.0)), Rejected)


def test_bad_covariance_is_rejected_not_spread() -> None:
    kalman_filter = made()
    broken = replace(fix(0.0, 0.0, 0.0), cov_ne_m2=((math.nan, 0.0), (0.0, 1.0)))
    outcome = kalman_filter.observe(broken)
    assert outcome == Rejected(Reason.NOT_FINITE, 0.0)


def test_what_the_air_told_before_the_memory_is_dropped() -> None:
    """As late as a fix that is refused for it."""
    filters = made(), made()
    for one in filters:
        for k in range(1, 200):
            one.drive(replace(velocity(k / 5), drive=Drive.INERTIAL, sigma_a_mps2=0.1))
    told = AirVelocity(S, (0.0, 0.0), np.eye(2), np.eye(2), None, (0.0, 0.0))
    assert isinstance(filters[0].observe(fix(1.0, 0.0, 0.0)), TooOld)
    filters[0].observe_air(AirError(S, (5.0, 5.0), told))
    np.testing.assert_array_equal(states(filters[0]), states(filters[1]))
