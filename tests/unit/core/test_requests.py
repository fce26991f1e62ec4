from __future__ import annotations

import math

import pytest

from visloc_companion.core.covariance import largest_sigma_m
from visloc_companion.core.requests import (
    FrameQueue,
    as_wide_as,
    bounded,
    heading_sigma_rad,
    height_sigma_m,
    held_by_gnss,
    least_height_sigma_m,
    pose_prior,
)
from visloc_companion.core.turns import Turns
from visloc_companion.geo import se3, wgs84
from visloc_companion.types import FrameRef, GeoPoint, LocaliseRequest, NavState, PosePrior, Vote

MS = 1_000_000
ORIGIN = GeoPoint(59.3, 18.1, 40.0)
LEVEL = (1.0, 0.0, 0.0, 0.0)
STATE = NavState(0, (100.0, 50.0, -120.0), (0.0, 0.0, 0.0), ((4.0, 1.0), (1.0, 9.0)), 3.0, 1.0)
PRIOR = pose_prior(STATE, ORIGIN, LEVEL, LEVEL, 0.0, 0.8, 0.02, 2000.0)


def frame(t_ms: int) -> FrameRef:
    return FrameRef(t_ms * MS, t_ms * MS, t_ms, 0, 640, 480, 1)


def take(queue: FrameQueue, now_ms: int) -> LocaliseRequest | None:
    got = queue.next_frame(now_ms * MS)
    return None if got is None else queue.taken(got, PRIOR, now_ms * MS)


def test_a_covariance_grows_to_a_sigma_and_never_shrinks() -> None:
    cov = ((4.0, 1.0), (1.0, 2.0))
    wide = as_wide_as(cov, 10.0)
    assert largest_sigma_m(wide) == pytest.approx(10.0)
    assert wide[0][1] / wide[0][0] == pytest.approx(0.25)
    assert as_wide_as(cov, 1.0) == cov


def test_newest_frame_wins_while_busy() -> None:
    queue = FrameQueue(5.0, seed=3, turns=Turns(False, 0))
    queue.offer(frame(0))
    first = take(queue, 1)
    assert first is not None
    assert queue.busy
    for t in (100, 200, 300):
        queue.offer(frame(t))
    queue.offer(frame(250))  # late and older: ignored
    assert take(queue, 310) is None
    queue.answered(99, True)
    assert queue.busy
    queue.answered(first.request_id, True)
    second = take(queue, 320)
    assert second is not None
    assert second.frame.frame_id == 300
    assert second.request_id == first.request_id + 1
    assert second.seed != first.seed
    assert take(queue, 900) is None


def test_a_question_out_of_turn_asks_for_the_image_and_changes_no_turn() -> None:
    queue = FrameQueue(100.0, seed=3, turns=Turns(True, 0))
    queue.offer(frame(0))
    first = take(queue, 1)
    assert first is not None
    queue.answered(first.request_id, False)  # the structure's turn is next
    for t in (100, 200):
        queue.offer(frame(t))
        assert queue.next_id == queue.taken(frame(t), PRIOR, t * MS, aside=True).request_id
        queue.answered(queue.next_id - 1, True)
    queue.offer(frame(300))
    after = take(queue, 301)
    assert after is not None
    assert after.vote is Vote.STRUCTURE


def test_rate_is_bounded() -> None:
    queue = FrameQueue(2.0, seed=1, turns=Turns(False, 0))
    asked = []
    for t in range(0, 4000, 50):
        queue.offer(frame(t))
        got = take(queue, t)
        if got is not None:
            asked.append(t)
            queue.answered(got.request_id, True)
    assert len(asked) == pytest.approx(4.0 * 2.0 / 0.8, abs=1)


def test_a_dead_worker_frees_the_queue_and_is_not_asked() -> None:
    queue = FrameQueue(5.0, seed=1, turns=Turns(False, 0))
    queue.offer(frame(0))
    assert take(queue, 0) is not None
    queue.worker(up=False)
    assert not queue.busy
    queue.offer(frame(500))
    assert take(queue, 500) is None
    queue.worker(up=True)
    assert take(queue, 510) is not None


def test_frames_that_waited_too_long_are_dropped() -> None:
    queue = FrameQueue(5.0, seed=1, turns=Turns(False, 0))
    queue.offer(frame(0))
    assert take(queue, 3001) is None
    queue.offer(frame(3000))
    assert take(queue, 3002) is not None


def test_prior_is_the_filters_state_with_the_cameras_attitude() -> None:
    q_ned_frd = se3.quat_from_euler(0.1, -0.05, 1.0)
    mount = se3.quat_from_euler(0.0, math.radians(20), 0.0)
    prior = pose_prior(STATE, ORIGIN, q_ned_frd, mount, 4.0, 1.0, 0.02, 2000.0)
    assert wgs84.ned_from_geo(prior.place, ORIGIN)[:2] == pytest.approx((100.0, 50.0), abs=1e-6)
    assert prior.place.h_amsl_m == pytest.approx(164.0)
    assert se3.angle_between(prior.q_ned_frd, se3.quat_multiply(q_ned_frd, mount)) < 1e-9
    assert prior.cov_ne_m2 == STATE.cov_ne_m2
    assert prior.sigma_yaw_rad == pytest.approx(math.radians(5))
    assert (prior.sigma_h_m, prior.sigma_tilt_rad) == (3.0, 0.02)
    assert height_sigma_m(120.0) == pytest.approx(4.2)


@pytest.mark.parametrize(("sigma_d", "expected"), [(0.01, 0.8), (3.0, 3.0), (50.0, 20.0)])
def test_height_sigma_has_bounds(sigma_d: float, expected: float) -> None:
    state = NavState(0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), ((1.0, 0.0), (0.0, 1.0)), sigma_d, 0.0)
    prior: PosePrior = pose_prior(state, ORIGIN, LEVEL, LEVEL, 0.0, 0.8, 0.02, 2000.0)
    assert prior.sigma_h_m == pytest.approx(expected)


def test_a_height_that_fixes_taught_is_doubted_while_none_come() -> None:
    least_m = [least_height_sigma_m(120.0, unseen_s) for unseen_s in (0.0, 2.0, 60.0, math.inf)]
    assert least_m == [pytest.approx(1.0), pytest.approx(2.0), height_sigma_m(120.0), height_sigma_m(120.0)]


def test_search_region_has_a_bound() -> None:
    assert bounded(((100.0**2, 0.0), (0.0, 50.0**2)), 10.0) == ((pytest.approx(100.0), 0.0), (0.0, pytest.approx(25.0)))
    assert bounded(STATE.cov_ne_m2, 10.0) == STATE.cov_ne_m2


def test_search_widens_while_gnss_holds_the_filter() -> None:
    cov = ((4.0, 1.0), (1.0, 9.0))
    assert held_by_gnss(cov, 4.0, 5.0) == cov
    assert held_by_gnss(cov, 10.0, 5.0) == ((4.0 + 25 + 64, 1.0), (1.0, pytest.approx(9.0 + 25 + 64)))
    assert held_by_gnss(cov, 1e6, 5.0)[0][0] == pytest.approx(4.0 + 25 + 1600)


def test_a_heading_that_was_pulled_is_searched_more_widely_up_to_a_limit() -> None:
    assert heading_sigma_rad(0.0, 0.0) == math.radians(5.0)
    assert heading_sigma_rad(math.radians(3.0), math.radians(4.0)) == pytest.approx(math.radians(math.sqrt(50.0)))
    assert heading_sigma_rad(0.0, math.pi) == pytest.approx(math.radians(math.hypot(5.0, 15.0)))
