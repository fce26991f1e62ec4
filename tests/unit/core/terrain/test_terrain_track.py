from __future__ import annotations

import pytest

from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.propagation import Drive
from visloc_companion.core.terrain.terrain_track import MAX_GAP_NS, LearnedVelocity, Track

S = 1_000_000_000


def velocity(t_s: float, north: float, down: float = 0.0, drive: Drive = Drive.AUTOPILOT) -> Velocity:
    return Velocity(round(t_s * S), (north, 0.0, down), 500.0, 0.3, drive)


def test_it_is_carried_by_the_mean_of_two_velocities_and_held_after_the_last() -> None:
    track = Track()
    assert track.at(0) is None
    assert not track.drive(velocity(0.0, 10.0))
    assert track.drive(velocity(1.0, 20.0, down=-2.0))
    node = track.at(round(1.5 * S))
    assert node is not None
    assert (node.north_m, node.flown_m, node.h_amsl_m) == pytest.approx((25.0, 25.0, 501.0))
    before = track.at(round(0.5 * S))
    assert before is not None
    assert (before.north_m, before.flown_m) == pytest.approx((5.0, 5.0))
    assert track.at(S + MAX_GAP_NS + 1) is None


@pytest.mark.parametrize("jump_m", [5.0, -20.0])
def test_a_jump_of_the_autopilots_height_is_no_step_of_the_ground(jump_m: float) -> None:
    """It climbs at 1 m/s throughout; at 10 s another sensor states the height."""
    track = Track()
    for k in range(200):
        h_amsl_m = 500.0 + k / 10 + (jump_m if k >= 100 else 0.0)
        track.drive(Velocity(k * S // 10, (10.0, 0.0, -1.0), h_amsl_m, 0.3, Drive.AUTOPILOT))
    node = track.at(round(19.9 * S))
    assert node is not None
    assert node.h_amsl_m == pytest.approx(519.9)
    track.drive(Velocity(30 * S, (10.0, 0.0, -1.0), 530.0 + jump_m, 0.3, Drive.AUTOPILOT))
    node = track.at(30 * S)
    assert node is not None
    assert node.h_amsl_m == pytest.approx(530.0 + jump_m), "it has begun anew"


def test_it_begins_anew_after_a_hole_with_another_velocity_and_when_time_goes_back() -> None:
    track = Track()
    track.drive(velocity(0.0, 10.0))
    assert not track.drive(velocity(2.0, 10.0))
    assert track.drive(velocity(2.5, 10.0))
    assert not track.drive(velocity(3.0, 10.0, drive=Drive.FED_BACK))
    assert not track.drive(velocity(2.9, 10.0, drive=Drive.FED_BACK))
    node = track.at(round(2.9 * S))
    assert node is not None
    assert node.flown_m == 0.0
    track.clear()
    assert track.at(round(2.9 * S)) is None


def test_the_error_that_is_learnt_is_forgotten() -> None:
    learned = LearnedVelocity()
    learned.learn(0, (40.0, 0.0), 10.0, since_s=5.0)
    assert learned.error_at(0) == (0.0, 0.0)
    learned.learn(0, (4.0, 0.0), 10.0, since_s=20.0)
    assert learned.error_at(0) == (0.0, 0.0)
    learned.learn(0, (40.0, 0.0), 10.0, since_s=20.0)
    north, east = learned.error_at(0)
    assert (north, east) == pytest.approx((2.0 * (1 - 1 / 16), 0.0))
    assert learned.error_at(2 * S)[0] == pytest.approx(north / 2.718, rel=1e-3)
    learned.learn(0, (4000.0, 0.0), 1.0, since_s=20.0)
    assert learned.error_at(0)[0] == pytest.approx(LearnedVelocity.MOST_MPS)
