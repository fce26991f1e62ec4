from __future__ import annotations

import math
from dataclasses import replace

import pytest

from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.propagation import Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.core.tracking import Tracker
from visloc_companion.geo import wgs84
from visloc_companion.types import Accepted, Fix, GeoPoint

S = 1_000_000_000
ORIGIN = GeoPoint(59.3, 18.1, 40.0)


def at(north: float, east: float = 0.0) -> GeoPoint:
    return wgs84.geo_from_ned((north, east, -100.0), ORIGIN)


def velocity(t_s: float, north: float = 10.0) -> Velocity:
    return Velocity(round(t_s * S), (north, 0.0, 0.0), 140.0, 0.3, Drive.AUTOPILOT)


def fix(t_s: float, north: float) -> Fix:
    t, cov = round(t_s * S), ((1.0, 0.0), (0.0, 1.0))
    return Fix(t, t, 1, 1, "t", at(north), (1.0, 0.0, 0.0, 0.0), cov, 1.0, 0.1, 0.0, 1.0)


def ready() -> Tracker:
    tracker = Tracker(NavigatorSettings())
    tracker.set_origin(ORIGIN)
    tracker.drive(velocity(0.0), 0, alone=False)
    assert tracker.seed(0, at(0.0), 2.0)
    return tracker


def test_nothing_before_origin_and_velocity() -> None:
    tracker = Tracker(NavigatorSettings())
    assert not tracker.seed(0, at(0.0), 5.0)
    assert tracker.set_origin(ORIGIN) is False
    assert not tracker.seed(0, at(0.0), 5.0)
    assert tracker.belief is None
    assert tracker.at(0) is None
    assert tracker.observe(fix(0.0, 0.0)) is None
    assert tracker.observe_gnss(0, at(0.0), 2.0) is None
    assert tracker.out_of_reach(0, at(500.0), 2.0) is False
    assert tracker.drive(velocity(0.0), 0, alone=False)
    assert tracker.seed(0, at(0.0), 5.0)


def test_the_same_velocity_in_another_message_is_taken_once() -> None:
    tracker = ready()
    assert tracker.drive(velocity(0.1), 0, alone=False)
    assert not tracker.drive(velocity(0.1, north=11.0), 0, alone=False)
    assert not tracker.drive(velocity(0.05), 0, alone=False)
    assert tracker.velocity == velocity(0.1)
    tracker.forget_velocity()
    assert tracker.drive(velocity(0.05), 0, alone=False)


def test_without_velocity_fixes_teach_it() -> None:
    """PX4 without any position tells no velocity; the vehicle flies 8 m/s north."""
    tracker = Tracker(NavigatorSettings())
    tracker.set_origin(ORIGIN)
    tracker.seed_without_velocity(0, 0, at(0.0), 10.0)
    for k in range(1, 101):
        tracker.observe(fix(0.2 * k, 8.0 * 0.2 * k))
    state = tracker.at(20 * S)
    assert state is not None
    assert state.v_ned_mps[0] == pytest.approx(8.0, abs=1.0)
    assert state.p_ned_m[0] == pytest.approx(160.0, abs=1.0)
    assert state.p_ned_m[2] == pytest.approx(-100.0)


def test_origin_moves_only_a_frame_in_use() -> None:
    tracker = ready()
    assert tracker.set_origin(ORIGIN) is False
    assert tracker.set_origin(at(100.0)) is True
    state = tracker.at(0)
    assert state is not None
    assert state.p_ned_m[0] == pytest.approx(-100.0, abs=1e-3)


def test_reach() -> None:
    tracker = ready()
    assert not tracker.out_of_reach(0, at(10.0), 1.5)
    assert tracker.out_of_reach(0, at(30.0), 1.5)
    assert isinstance(tracker.observe(fix(0.0, 0.5)), Accepted)
    assert isinstance(tracker.observe_gnss(0, at(0.5), 5.0), Accepted)


def felt(tracker: Tracker, from_s: float, to_s: float, a_north: float) -> None:
    for k in range(round(from_s * 50), round(to_s * 50)):
        tracker.on_force(k * 20_000_000, (a_north, 0.0, -9.80665), (1.0, 0.0, 0.0, 0.0))


def taught() -> Tracker:
    """After a second at rest in acceleration, and two fixes."""
    tracker = Tracker(NavigatorSettings())
    tracker.set_origin(ORIGIN)
    felt(tracker, 0.0, 1.02, 0.0)
    tracker.drive(velocity(1.0), 1 * S, alone=False)
    assert tracker.seed(1 * S, at(0.0), 1.0)
    for k in (1, 2):
        assert isinstance(tracker.observe(replace(fix(1.0 + 0.01 * k, 0.0), frame_id=k)), Accepted)
    return tracker


def test_accelerations_drive_the_filter_while_something_teaches_their_error() -> None:
    """The vehicle speeds up by 1 m/s² northwards; the autopilot, which flies on our own positions, does not notice."""
    tracker = taught()
    drives, speeds = [], []
    for k in range(11, 141):
        felt(tracker, 0.1 * k - 0.08, 0.1 * k + 0.02, 1.0)
        tracker.drive(velocity(0.1 * k), round(0.1 * k * S), alone=True)
        belief, state = tracker.belief, tracker.at(round(0.1 * k * S))
        assert belief is not None
        assert state is not None
        drives.append(belief.drive)
        speeds.append(state.v_ned_mps[0])
    assert drives[:59] == [Drive.INERTIAL] * 59
    assert drives[-1] is Drive.AUTOPILOT
    assert speeds[50] - speeds[0] == pytest.approx(5.0, abs=0.1)
    assert speeds[-1] == pytest.approx(10.0)


def test_a_late_fix_does_not_make_the_accelerations_untaught() -> None:
    tracker, answers = taught(), {50: 4.0, 55: 2.0, 60: 5.0}
    drives = []
    for k in range(11, 110):
        felt(tracker, 0.1 * k - 0.08, 0.1 * k + 0.02, 0.0)
        tracker.drive(velocity(0.1 * k), round(0.1 * k * S), alone=True)
        if (t_s := answers.get(k)) is not None:
            assert isinstance(tracker.observe(replace(fix(t_s, 10.0 * (t_s - 1.0)), frame_id=k)), Accepted)
        belief = tracker.belief
        assert belief is not None
        drives.append(belief.drive)
    assert drives.index(Drive.AUTOPILOT) == 100 - 11 + 1


@pytest.mark.parametrize("known", [True, False])
def test_a_place_of_some_time_ago_is_carried_to_the_start(known: bool) -> None:
    """The answer that shows it took two seconds: by the velocities since then, or as good as it goes by the last one."""
    tracker = ready()
    if not known:
        tracker.forget()
    for k in range(1, 41):
        tracker.drive(velocity(k / 10, north=10.0 if k <= 30 else 20.0), 0, alone=False)
    assert tracker.seed(2 * S, at(100.0), 2.0)
    state = tracker.at(4 * S)
    assert state is not None
    assert state.p_ned_m[0] == pytest.approx(130.0 if known else 140.0, abs=0.6)
    assert state.cov_ne_m2[0][0] > 2.0**2 + 0.5**2


def test_a_filter_that_knows_the_velocitys_error_takes_it_off_the_way() -> None:
    """The vehicle flies 8 m/s while its autopilot says 10."""
    tracker = ready()
    for k in range(1, 41):
        tracker.drive(velocity(k / 5), 0, alone=False)
        tracker.observe(fix(k / 5, 8.0 * k / 5))
    assert tracker.seed(6 * S, at(100.0), 2.0)
    state = tracker.at(8 * S)
    assert state is not None
    assert state.p_ned_m[0] == pytest.approx(116.0, abs=1.0)


def test_before_a_velocity_only_a_height_that_is_told_makes_a_vehicle_low() -> None:
    tracker = Tracker(NavigatorSettings(min_height_m=15.0))
    assert not tracker.low
    tracker.height_above_home_m = 5.0
    assert tracker.low
    tracker.height_above_home_m = 100.0
    assert not tracker.low


def sigmas_m(tracker: Tracker, t_s: float) -> tuple[float, float]:
    state = tracker.at(round(t_s * S))
    assert state is not None
    return math.sqrt(state.cov_ne_m2[0][0]), math.sqrt(state.cov_ne_m2[1][1])


def leaning(t_s: float) -> Fix:
    """That a lens which is twice as long moves by 100 m to the north."""
    return replace(fix(t_s, 0.0), per_focal_ne_m=(100.0, 0.0))


def test_a_lens_and_a_map_in_doubt_before_the_filter_starts_are_in_doubt_in_it() -> None:
    plain, doubtful = ready(), Tracker(NavigatorSettings())
    doubtful.doubt_lens(leaning(0.0), 0.1)
    doubtful.know_map(6.0)
    doubtful.set_origin(ORIGIN)
    doubtful.drive(velocity(0.0), 0, alone=False)
    assert doubtful.seed(0, at(0.0), 2.0)
    assert doubtful.shared_m == 6.0
    for tracker in (plain, doubtful):
        assert isinstance(tracker.observe(leaning(0.0)), Accepted)
    assert sigmas_m(plain, 0.0)[0] < 2.0
    assert sigmas_m(doubtful, 0.0)[0] > sigmas_m(doubtful, 0.0)[1] > 4.0, "along the lean more than aside"


def test_a_lens_that_is_doubted_no_more_before_the_filter_starts_is_not_in_it() -> None:
    tracker = Tracker(NavigatorSettings())
    tracker.doubt_lens(leaning(0.0), 0.1)
    tracker.know_lens(0.0)
    assert tracker.longer_share == 0.0
    tracker.doubt_lens(leaning(0.0), 0.1, lasts=True)
    tracker.know_lens(0.0)
    assert tracker.longer_share == 0.1, "it lasts"
    tracker.know_lens(0.0, lasts=False)
    assert tracker.longer_share == 0.0
    assert not tracker.lens_doubt_lasts


def test_what_happens_before_the_filter_starts_widens_nothing() -> None:
    """Clocks that step, a GNSS that dragged, a camera whose motion or time was wrong."""
    tracker, plain = Tracker(NavigatorSettings()), ready()
    tracker.set_origin(ORIGIN)
    tracker.drive(velocity(0.0), 0, alone=False)
    for happen in (
        tracker.doubt_motion,
        lambda: tracker.retimed(0.5),
        lambda: tracker.stood(0, 5 * S),
        lambda: tracker.leapt(0, 5 * S, 0),
        lambda: tracker.dragged(0, 50.0),
    ):
        happen()
        assert tracker.at(0) is None
    assert tracker.seed(0, at(0.0), 2.0)
    assert sigmas_m(tracker, 0.0) == sigmas_m(plain, 0.0)
