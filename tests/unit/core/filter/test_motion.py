from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from visloc_companion.core.estimator import PositionFilter
from visloc_companion.core.filter import fusion
from visloc_companion.core.filter.belief import Belief, seeded
from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.motion import Motion, learned, weighed
from visloc_companion.core.filter.propagation import ODOMETRY_HEADING, ODOMETRY_LENS, ODOMETRY_SCALE, VELOCITY, Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.types import Accepted, Fix, GeoPoint, Rejected, TooOld

S = 1_000_000_000
SETTINGS = NavigatorSettings()
V = VELOCITY.start
ORIGIN = GeoPoint(59.3, 18.1, 40.0)
SMALL = ((0.01, 0.0), (0.0, 0.01))


def motion(t_s: float, d_ne_m: tuple[float, float], shared: tuple[float, float] = (0.0, 0.0), span_s: float = 0.5) -> Motion:
    return Motion(round(t_s * S), round((t_s - span_s) * S), d_ne_m, SMALL, *shared)


def velocity(t_s: float, north_mps: float = 10.5, drive: Drive = Drive.FED_BACK) -> Velocity:
    return Velocity(round(t_s * S), (north_mps, 0.0, 0.0), 140.0, 0.8, drive)


def started() -> PositionFilter:
    return PositionFilter(SETTINGS, ORIGIN, seeded(0, (0.0, 0.0), 1.0, 0.8, Drive.FED_BACK, SETTINGS), velocity(0.0))


@pytest.mark.parametrize("drive", [Drive.AUTOPILOT, Drive.FED_BACK])
def test_the_error_of_the_velocity_is_learned_whatever_it_rests_on(drive: Drive) -> None:
    belief = seeded(0, (0.0, 0.0), 1.0, 0.8, drive, SETTINGS)
    for k in range(1, 41):
        belief = fusion.propagated(belief, k * S // 2, (10.5, 0.0), SETTINGS)
        belief, outcome = learned(belief, motion(k / 2, (5.0, 0.0)), (5.25, 0.0), SETTINGS)
        assert isinstance(outcome, Accepted)
    assert belief.x[V] == pytest.approx(0.5, abs=0.1)
    assert math.sqrt(belief.P[V, V]) < 0.3


def test_the_position_follows_the_camera_and_not_the_velocity() -> None:
    with_camera, alone = started(), started()
    for k in range(1, 201):
        for one in (with_camera, alone):
            one.drive(velocity(0.1 * k))
        if k % 5 == 0:
            with_camera.observe_motion(motion(0.1 * k, (5.0, 0.0)))
    assert with_camera.at(20 * S).p_ned_m[0] == pytest.approx(200.0, abs=2.5)
    assert alone.at(20 * S).p_ned_m[0] == pytest.approx(210.0, abs=1e-6)
    assert with_camera.at(20 * S).cov_ne_m2[0][0] < 0.2 * alone.at(20 * S).cov_ne_m2[0][0]


@given(st.floats(1e-3, 4), st.floats(1e-3, 4), st.floats(1e-4, 4), st.floats(1e-4, 4), st.floats(0, 1), st.floats(-0.9, 0.9))
def test_no_number_of_intervals_makes_it_better_than_what_lasts(
    p0: float, p1: float, r0: float, r1: float, least: float, c: float
) -> None:
    P = np.diag([p0, p1])
    R = np.array([[r0, c * math.sqrt(r0 * r1)], [c * math.sqrt(r0 * r1), r1]])
    for _ in range(30):
        raised = weighed(R, P, np.full(2, least))
        assert (np.diag(raised) >= np.diag(R)).all()
        P = np.diag(np.diag(P - P @ np.linalg.solve(P + np.diag(np.diag(raised)), P)))
    assert (np.diag(P) >= min(least, p0, p1) * (1 - 1e-3)).all()


def test_what_lasts_keeps_the_sigma_of_the_velocity() -> None:
    belief = seeded(0, (0.0, 0.0), 1.0, 0.8, Drive.FED_BACK, SETTINGS)
    for k in range(1, 400):
        belief = fusion.propagated(belief, k * S // 2, (10.0, 0.0), SETTINGS)
        belief, _ = learned(belief, motion(k / 2, (5.0, 0.0), shared=(0.03, math.radians(1.0))), (5.0, 0.0), SETTINGS)
    assert belief.P[V, V] >= (0.03 * 10) ** 2 * 0.95
    assert belief.P[V + 1, V + 1] >= (math.radians(1.0) * 10) ** 2 * 0.95
    assert belief.P[V + 1, V + 1] < belief.P[V, V]


def test_fixes_tell_scale_and_heading_of_the_odometry_from_the_error_of_the_velocity() -> None:
    """It sees 1 % too much and 1 degree too far clockwise; the inertial velocity is 0.3 m/s too fast northwards."""
    scale, turn = 1.01, math.radians(1.0)
    belief = fusion.with_inertial_velocity(seeded(0, (0.0, 0.0), 1.0, 0.8, Drive.AUTOPILOT, SETTINGS), 0.05)
    for k in range(1, 241):
        belief = fusion.propagated(belief, k * S // 2, (25.3, 0.0), SETTINGS)
        seen = (12.5 * scale * math.cos(turn), 12.5 * scale * math.sin(turn))
        belief, _ = learned(belief, motion(k / 2, seen, (0.01, math.radians(1.0))), (12.65, 0.0), SETTINGS)
        fixed = fusion.Position(k * S // 2, (12.5 * k, 0.0), ((0.5, 0.0), (0.0, 0.5)), from_fix=True)
        belief, _ = fusion.observed(belief, fixed, SETTINGS)
    assert belief.x[ODOMETRY_SCALE] == pytest.approx(0.01, abs=0.004)
    assert belief.x[ODOMETRY_HEADING] == pytest.approx(turn, abs=math.radians(0.25))
    assert belief.x[V] == pytest.approx(0.3, abs=0.12)
    assert math.sqrt(belief.P[V, V]) < 0.21


def rocking(claimed: bool) -> Belief:
    """Two minutes at 25 m/s with a lens 2 % longer than calibrated: the axis swings over the ground by up to 126 m in a second,
    there and back in ten; fixes are good to 0.7 m. `claimed`: odometry says that it swung."""
    belief = fusion.with_inertial_velocity(seeded(0, (0.0, 0.0), 1.0, 0.8, Drive.AUTOPILOT, SETTINGS), 0.05)
    for k in range(1, 241):
        belief = fusion.propagated(belief, k * S // 2, (25.0, 0.0), SETTINGS)
        axis_m = [200.0 * math.sin(2 * math.pi * t / 20) for t in (k - 1, k)]
        seen = motion(k / 2, (12.5, 0.02 * (axis_m[1] - axis_m[0])))
        swung = replace(seen, sigma_focal=0.015, per_focal_ne_m=(0.0, axis_m[1] - axis_m[0]))
        belief, _ = learned(belief, swung if claimed else seen, (12.5, 0.0), SETTINGS)
        fixed = fusion.Position(k * S // 2, (12.5 * k, 0.0), ((0.5, 0.0), (0.0, 0.5)), from_fix=True)
        belief, _ = fusion.observed(belief, fixed, SETTINGS)
    return belief


def test_a_wrong_lens_is_learned_while_the_axis_swings() -> None:
    belief = rocking(claimed=True)
    assert belief.x[ODOMETRY_LENS] == pytest.approx(0.02, abs=0.004)
    assert math.sqrt(belief.P[ODOMETRY_LENS, ODOMETRY_LENS]) < 0.004
    assert abs(belief.x[V + 1]) < 0.15 < abs(rocking(claimed=False).x[V + 1])


def test_a_lens_claimed_worse_than_the_state_for_it_keeps_the_sigma_of_the_velocity() -> None:
    belief = seeded(0, (0.0, 0.0), 1.0, 0.8, Drive.FED_BACK, SETTINGS)
    for k in range(1, 400):
        belief = fusion.propagated(belief, k * S // 2, (10.0, 0.0), SETTINGS)
        seen = replace(motion(k / 2, (5.0, 0.0)), sigma_focal=0.05, per_focal_ne_m=(5.0, 0.0))
        belief, _ = learned(belief, seen, (5.0, 0.0), SETTINGS)
    assert belief.P[V, V] >= (0.05**2 - 0.015**2) * 10**2 * 0.95


def test_a_velocity_that_errs_anew_within_a_moment_is_followed() -> None:
    belief = seeded(0, (0.0, 0.0), 1.0, 0.8, Drive.FED_BACK, SETTINGS)
    for k in range(1, 41):
        belief = fusion.propagated(belief, k * S // 2, (10.0, 0.0), SETTINGS)
        error = -1.0 if k <= 20 else 1.5
        belief, outcome = learned(belief, motion(k / 2, (5.0, 0.0)), (5.0 + error / 2, 0.0), SETTINGS)
        assert isinstance(outcome, Accepted) is (k != 21)
        if k == 21:
            assert abs(belief.x[V] - 1.5) < 1.5 * math.sqrt(belief.P[V, V])
        if k == 22:
            assert belief.x[V] == pytest.approx(1.5, abs=0.3)
    assert belief.x[V] == pytest.approx(1.5, abs=0.15)


def settled_velocity() -> Belief:
    """The velocity errs by 0.3 m/s, as twenty intervals of half a second have told."""
    belief = seeded(0, (0.0, 0.0), 1.0, 0.8, Drive.FED_BACK, SETTINGS)
    for k in range(1, 21):
        belief = fusion.propagated(belief, k * S // 2, (10.0, 0.0), SETTINGS)
        belief, _ = learned(belief, motion(k / 2, (5.0, 0.0)), (5.15, 0.0), SETTINGS)
    return belief


def after_intervals(belief: Belief, first: int, errors_mps: tuple[float, ...]) -> tuple[Belief, list[bool]]:
    """Half a second each, from number `first` on, and whether each was taken."""
    taken = []
    for k, error in enumerate(errors_mps, first):
        belief = fusion.propagated(belief, k * S // 2, (10.0, 0.0), SETTINGS)
        belief, outcome = learned(belief, motion(k / 2, (5.0, 0.0)), (5.0 + error / 2, 0.0), SETTINGS)
        taken.append(isinstance(outcome, Accepted))
    return belief, taken


@pytest.mark.parametrize("false", [(7.0,), (7.0, -4.0), (-6.0, 3.0, 8.0)])
def test_intervals_that_nothing_agrees_with_move_nothing_and_leave_it_open(false: tuple[float, ...]) -> None:
    before = settled_velocity()
    doubted, taken = after_intervals(before, 21, false)
    assert taken == [False] * len(false)
    assert doubted.x[V] == pytest.approx(before.x[V], abs=0.1)
    assert math.sqrt(doubted.P[V, V]) > 0.6 * max(abs(error) for error in false)
    assert math.sqrt(doubted.P[0, 0]) < 1.5 + 0.5 * sum(abs(error) for error in false)
    after, taken = after_intervals(doubted, 21 + len(false), (0.3, 0.3))
    assert taken == [True, True]
    assert after.x[V] == pytest.approx(0.3, abs=0.15)
    assert math.sqrt(after.P[V, V]) < 0.4


def test_another_velocity_begins_without_the_doubt_about_the_former() -> None:
    doubted, _ = after_intervals(settled_velocity(), 21, (6.0,))
    assert doubted.doubt is not None
    assert fusion.with_velocity_trust(doubted, 0.3, Drive.AUTOPILOT).doubt is None
    goes_on = fusion.with_inertial_velocity(doubted, 0.1)
    assert goes_on.doubt is doubted.doubt, "an inertial velocity begins with the error of the autopilot's"


def test_an_impossible_motion_is_refused() -> None:
    belief = fusion.propagated(seeded(0, (0.0, 0.0), 1.0, 0.8, Drive.FED_BACK, SETTINGS), S, (10.0, 0.0), SETTINGS)
    same, outcome = learned(belief, motion(1.0, (60.0, 0.0)), (5.0, 0.0), SETTINGS)
    assert same is belief
    assert isinstance(outcome, Rejected)


def test_order_of_arrival_does_not_matter() -> None:
    def fix(t_s: float) -> Fix:
        place = wgs84.geo_from_ned((10.0 * t_s, 0.3, -100.0), ORIGIN)
        t_ns = round(t_s * S)
        return Fix(t_ns, t_ns, 1, 1, "deep", place, (1.0, 0.0, 0.0, 0.0), ((0.5, 0.0), (0.0, 0.5)), 2.0, 0.1, 0.01, 5.0)

    in_order, late = started(), started()
    events = [(0.1 * k, velocity(0.1 * k)) for k in range(1, 121)]
    extra = [(0.5 * k, motion(0.5 * k, (5.0, 0.1))) for k in range(1, 24)]
    fixes = [(0.4 * k, fix(0.4 * k)) for k in range(1, 29)]

    def give(one: PositionFilter, item: Velocity | Motion | Fix) -> None:
        if isinstance(item, Velocity):
            one.drive(item)
        elif isinstance(item, Motion):
            one.observe_motion(item)
        else:
            one.observe(item)

    for _, item in sorted([*events, *extra, *fixes], key=lambda pair: pair[0]):
        give(in_order, item)
    for _, item in sorted(
        [*events, *((t + 0.33, m) for t, m in extra), *((t + 0.71, f) for t, f in fixes)], key=lambda pair: pair[0]
    ):
        give(late, item)
    a, b = in_order.at(12 * S), late.at(12 * S)
    np.testing.assert_allclose(a.p_ned_m, b.p_ned_m, atol=1e-9)
    np.testing.assert_allclose(a.cov_ne_m2, b.cov_ne_m2, atol=1e-9)
    assert in_order.protection_level_m(12 * S) == pytest.approx(late.protection_level_m(12 * S), rel=1e-6)


def test_an_interval_that_begins_before_the_memory_is_too_old() -> None:
    one = started()
    for k in range(1, 200):
        one.drive(velocity(0.1 * k))
    assert isinstance(one.observe_motion(motion(2.0, (5.0, 0.0))), TooOld)


def test_the_memory_keeps_the_start_of_an_interval_that_it_still_holds() -> None:
    one, other = started(), started()
    for k in range(1, 101):
        for each in (one, other):
            each.drive(velocity(0.1 * k))
        if k == 40:
            one.observe_motion(motion(4.0, (30.0, 0.0), span_s=3.0))
            other.observe_motion(motion(4.0, (30.0, 0.0), span_s=3.0))
    one.drive(velocity(9.95))
    other.drive(velocity(9.95))
    np.testing.assert_allclose(one.at(10 * S).p_ned_m, other.at(10 * S).p_ned_m, atol=1e-12)
    assert one.at(10 * S).p_ned_m[0] < 105.0


def test_nothing_is_forgotten_while_an_interval_that_began_before_it_is_held() -> None:
    """The first interval is older than the memory by then, the second began before all that is in the log."""
    one = started()
    one.drive(velocity(0.5))
    one.observe_motion(motion(0.6, (5.0, 0.0)))
    one.observe_motion(motion(5.0, (49.0, 0.0), span_s=4.8))
    one.drive(velocity(7.0))
    assert one.earliest_ns == 0
    assert isinstance(one.observe_motion(motion(0.4, (3.0, 0.0), span_s=0.3)), Accepted)
    one.drive(velocity(11.5))
    assert one.earliest_ns == 5 * S


def replaced_velocity(at_s: float) -> Belief:
    """At `at_s` seconds an inertial velocity that erred by 5 m/s, well known, gives way to the autopilot's, which is right."""
    belief = seeded(0, (0.0, 0.0), 1.0, 0.8, Drive.INERTIAL, SETTINGS)
    x = belief.x.copy()
    x[VELOCITY] = 5.0, -4.0
    P = belief.P.copy()
    P[VELOCITY, VELOCITY] = 0.2**2 * np.eye(2)
    inertial = fusion.propagated(belief._replace(x=x, P=P), round(at_s * S), (15.0, -4.0), SETTINGS)
    return fusion.with_velocity_trust(inertial, 0.8, Drive.FED_BACK)


@pytest.mark.parametrize("at_s", [0.1, 0.6, 1.2])
def test_an_interval_in_which_the_velocity_was_replaced_does_not_lay_the_former_error_to_the_present_one(at_s: float) -> None:
    belief = fusion.propagated(replaced_velocity(at_s), round(1.25 * S), (10.0, 0.0), SETTINGS)
    travel_ne_m = (15.0 * at_s + 10.0 * (1.25 - at_s), -4.0 * at_s)
    after, outcome = learned(belief, motion(1.25, (12.5, 0.0), span_s=1.25), travel_ne_m, SETTINGS)
    assert isinstance(outcome, Accepted)
    sigma = np.sqrt(np.diag(after.P)[VELOCITY])
    assert (np.abs(after.x[VELOCITY]) < 2 * sigma).all()
    assert (sigma > 0.7 * min(0.8, 0.2 * at_s / (1.25 - at_s))).all(), "what the former error leaves open counts"
    assert (sigma <= np.sqrt(np.diag(belief.P)[VELOCITY])).all()


def test_an_interval_that_began_two_velocities_ago_tells_nothing() -> None:
    once = fusion.propagated(replaced_velocity(0.4), round(0.8 * S), (10.0, 0.0), SETTINGS)
    twice = fusion.with_velocity_trust(once, 0.3, Drive.AUTOPILOT)
    belief = fusion.propagated(twice, round(1.25 * S), (10.0, 0.0), SETTINGS)
    within, outcome = learned(belief, motion(1.25, (8.5, 0.0), span_s=0.85), (8.5, 0.0), SETTINGS)
    assert isinstance(outcome, Accepted)
    assert within.P[V, V] < belief.P[V, V]
    unchanged, outcome = learned(belief, motion(1.25, (12.5, 0.0), span_s=1.25), (14.5, -1.6), SETTINGS)
    assert outcome == Rejected(Reason.TOO_OLD, 0.0)
    assert unchanged is belief
