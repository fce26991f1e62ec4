"""The eyes that know the truth."""

from __future__ import annotations

import asyncio
import contextlib
import re
import statistics
from dataclasses import replace
from pathlib import Path

import pytest

from visloc_companion.app import live
from visloc_companion.app.clock import ManualClock
from visloc_companion.core.heights.height import news_of
from visloc_companion.errors import Reason
from visloc_companion.geo.wgs84 import geo_from_ned, ned_from_geo
from visloc_companion.sim.real.oracle import HEIGHT_SIGMA_M, Oracle, OracleSettings, View, answered_height
from visloc_companion.types import Fix, FrameRef, GeoPoint, LocaliseRequest, NoFix, Odometry, PosePrior, Quat

PLACE = GeoPoint(47.4, 8.5, 550.0)
LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)


def request_about(frame: FrameRef, number: int = 1) -> LocaliseRequest:
    return LocaliseRequest(number, frame, PosePrior(PLACE, LEVEL, ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.1, 0.1), seed=1)


def shown(oracle: Oracle, n: int, step_ns: int = 50_000_000) -> list[FrameRef]:
    frames: list[FrameRef] = []
    oracle.on_frame, oracle.shows = frames.append, True
    for k in range(n):
        oracle.see(k * step_ns, PLACE, LEVEL)
    return frames


def test_frames_come_at_their_rate_with_the_autopilots_time() -> None:
    frames = shown(Oracle(OracleSettings(rate_hz=4.0), ManualClock(7), 1), 101)
    assert len(frames) == 21
    assert [frame.t_boot_ns for frame in frames[:3]] == [0, 250_000_000, 500_000_000]


def test_nothing_is_shown_before_it_is_told_to() -> None:
    oracle = Oracle(OracleSettings(), ManualClock(), 1)
    oracle.on_frame = lambda _frame: (_ for _ in ()).throw(AssertionError)
    oracle.see(0, PLACE, LEVEL)


def test_a_camera_may_take_more_frames_than_are_asked_about() -> None:
    frames = shown(Oracle(OracleSettings(rate_hz=4.0, camera_hz=10.0), ManualClock(7), 1), 101)
    assert len(frames) == 51


async def answered(oracle: Oracle, clock: ManualClock, after_s: float) -> list[object]:
    serving = asyncio.create_task(oracle.serve())
    clock.advance(after_s)
    await asyncio.sleep(0.02)
    serving.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await serving
    return [await oracle.events.get() for _ in range(len(oracle.events))]


async def test_an_answer_is_late_by_the_latency_and_off_by_the_noise() -> None:
    clock = ManualClock(1_000_000_000)
    oracle = Oracle(OracleSettings(rate_hz=20.0, sigma_m=0.7, latency_s=0.25), clock, 1)
    for number, frame in enumerate(shown(oracle, 50), 1):
        oracle.submit(request_about(frame, number))
    assert await answered(oracle, clock, 0.24) == []
    fixes = await answered(oracle, clock, 0.02)
    errors = [ned_from_geo(fix.place, PLACE)[0] for fix in fixes if isinstance(fix, Fix)]
    assert len(errors) == 16  # the mailbox holds so many; nobody asks for more at a time
    assert 0.35 < statistics.pstdev(errors) < 1.2


async def test_a_picture_travels_for_a_while_and_keeps_its_time() -> None:
    clock, frames = ManualClock(1_000_000_000), []
    oracle = Oracle(OracleSettings(frame_delay_s=0.3), clock, 1)
    oracle.on_frame, oracle.shows = frames.append, True
    oracle.see(77, PLACE, LEVEL)
    assert frames == []
    await answered(oracle, clock, 0.31)
    (frame,) = frames
    assert (frame.t_boot_ns, frame.t_ns) == (77, 1_000_000_000)
    assert frame.t_rx_ns >= 1_300_000_000


async def test_it_is_blind_and_moved_when_the_scenario_says() -> None:
    clock = ManualClock(1_000_000_000)
    settings = OracleSettings(rate_hz=1.0, sigma_m=0.0, blind=((1.0, 2.0),), moved=((3.0, 4.0, 5.0, 20.0),))
    oracle = Oracle(settings, clock, 1)
    frames = shown(oracle, 5, step_ns=1_000_000_000)
    oracle.begun_boot_ns = 0
    for number, frame in enumerate(frames, 1):
        oracle.submit(request_about(frame, number))
    answers = await answered(oracle, clock, 1.0)
    assert [type(answer) for answer in answers] == [Fix, NoFix, Fix, Fix, Fix]
    offs = [ned_from_geo(answer.place, PLACE)[:2] for answer in answers if isinstance(answer, Fix)]
    assert offs[2] == pytest.approx((5.0, 20.0), abs=1e-3)
    assert offs[0] == offs[3] == pytest.approx((0.0, 0.0), abs=1e-3)
    assert oracle.offset_ne_m(3_500_000_000) == (5.0, 20.0)


async def motions(oracle: Oracle, clock: ManualClock, steps_s: list[float], t_s: float = 0.0) -> list[Odometry | None]:
    """What answers say of the camera's motion, to frames so long after each other from a time on; 10 m/s north."""
    frames: list[FrameRef] = []
    oracle.on_frame, oracle.shows = frames.append, True
    answers: list[object] = []
    for number, step_s in enumerate(steps_s, 1):
        t_s += step_s
        clock.advance(step_s)
        oracle.see(round(t_s * 1e9), geo_from_ned((10.0 * t_s, 0.0, 0.0), PLACE), LEVEL)
        oracle.submit(request_about(frames[-1], number))
        answers += await answered(oracle, clock, 0.0)
    return [answer.motion for answer in answers if isinstance(answer, Fix | NoFix)]


async def test_answers_bring_the_cameras_motion_where_the_flight_says_so() -> None:
    settings = OracleSettings(rate_hz=2.0, latency_s=0.0, odometry=True)
    clock = ManualClock(1_000_000_000)
    first, *seen = await motions(Oracle(settings, clock, 1), clock, [0.5] * 40)
    assert first is None
    assert all(motion is not None for motion in seen)
    moved = [(m.displacement_ned_m[0] - 1e-8 * (m.t_to_ns - m.t_from_ns), m) for m in seen if m is not None]
    assert all(abs(off_m) < 4 * m.cov_ne_m2[0][0] ** 0.5 for off_m, m in moved)
    assert 0.05 < statistics.pstdev(off_m for off_m, _ in moved) < 0.3
    assert max(m.t_to_ns - m.t_from_ns for _, m in moved) == 2_000_000_000
    without = ManualClock(1_000_000_000)
    assert await motions(Oracle(replace(settings, odometry=False), without, 1), without, [0.5] * 3) == [None] * 3


async def test_motion_begins_anew_where_the_ground_was_not_followed() -> None:
    """Blind, after a time without frames, and of a daemon that began anew."""
    settings = OracleSettings(rate_hz=2.0, latency_s=0.0, odometry=True, blind=((1.4, 1.6),))
    clock = ManualClock(1_000_000_000)
    oracle = Oracle(settings, clock, 1)
    oracle.begun_boot_ns = 0
    seen = await motions(oracle, clock, [0.5, 0.5, 0.5, 0.5, 0.5, 3.0, 0.5])
    assert [motion is not None for motion in seen] == [False, True, False, False, True, False, True]
    oracle.forget()
    assert [motion is not None for motion in await motions(oracle, clock, [0.5, 0.5], t_s=6.0)] == [False, True]


async def test_a_daemon_that_died_is_answered_nothing() -> None:
    clock = ManualClock(1_000_000_000)
    oracle = Oracle(OracleSettings(), clock, 1)
    oracle.submit(request_about(shown(oracle, 1)[0]))
    oracle.forget()
    assert await answered(oracle, clock, 1.0) == []


async def test_a_frame_that_it_forgot_is_refused() -> None:
    clock = ManualClock()
    oracle = Oracle(OracleSettings(), clock, 1)
    oracle.submit(request_about(FrameRef(0, 0, 99, 0, 640, 480, 3)))
    (answer,) = await answered(oracle, clock, 1.0)
    assert isinstance(answer, NoFix)
    assert answer.reason is Reason.BAD_FRAME


async def test_another_answer_than_the_truth_is_as_late_and_as_blind() -> None:
    clock = ManualClock(1_000_000_000)
    asked = list[View]()

    def localise(request: LocaliseRequest, view: View) -> NoFix:
        asked.append(view)
        return NoFix(0, request.frame.t_ns, request.request_id, request.frame.frame_id, "another", Reason.AMBIGUOUS, 0.0)

    oracle = Oracle(OracleSettings(rate_hz=1.0, latency_s=0.25, blind=((0.0, 0.5),)), clock, 1, localise)
    frames = shown(oracle, 2, step_ns=1_000_000_000)
    oracle.begun_boot_ns = 0
    for number, frame in enumerate(frames, 1):
        oracle.submit(request_about(frame, number))
    first, second = await answered(oracle, clock, 0.3)
    assert isinstance(first, NoFix)
    assert isinstance(second, NoFix)
    assert (first.reason, second.reason) == (Reason.NO_MATCH, Reason.AMBIGUOUS)
    assert second.t_rx_ns == 1_250_000_000
    assert [view.t_boot_ns for view in asked] == [1_000_000_000]


async def test_one_picture_of_several_is_recognised_and_all_show_the_motion() -> None:
    clock = ManualClock(1_000_000_000)
    oracle = Oracle(OracleSettings(rate_hz=4.0, latency_s=0.0, odometry=True, recognised_of=4), clock, 1)
    frames: list[FrameRef] = []
    oracle.on_frame, oracle.shows = frames.append, True
    answers: list[object] = []
    for number in range(1, 13):
        oracle.see(250_000_000 * number, PLACE, LEVEL)
        oracle.submit(request_about(frames[-1], number))
        answers += await answered(oracle, clock, 0.25)
    assert [number for number, answer in enumerate(answers, 1) if isinstance(answer, Fix)] == [4, 8, 12]
    declined = [answer for answer in answers if isinstance(answer, NoFix)]
    assert {answer.reason for answer in declined} == {Reason.NO_MATCH}
    assert [number for number, answer in enumerate(answers, 1) if answer.motion is None] == [1]  # type: ignore[attr-defined]


def test_the_prior_of_a_request_is_in_the_height_as_of_a_localiser() -> None:
    """Else taking it out again makes metres of noise of what was seen to one, and a lens that zooms of that."""
    prior = PosePrior(replace(PLACE, h_amsl_m=PLACE.h_amsl_m + 5.0), LEVEL, ((1.0, 0.0), (0.0, 1.0)), 1.5, 0.1, 0.1)
    h_m, sigma_m = answered_height(PLACE.h_amsl_m, prior)
    news = news_of(h_m, sigma_m, prior.place.h_amsl_m, prior.sigma_h_m)
    assert news == pytest.approx((PLACE.h_amsl_m, HEIGHT_SIGMA_M**2))


def test_it_has_all_that_the_daemon_asks_of_its_worker() -> None:
    """It stands in for the supervisor where no file says so: what is read of `parts.worker` in app/live.py."""
    source = Path(live.__file__).read_text(encoding="utf-8")
    asked = set(re.findall(r"\bworker\.([a-z_]+)", source)) - {"events"}
    assert {"pack_seal", "given_up", "overdue"} <= asked
    oracle = Oracle(OracleSettings(), ManualClock(), 1)
    assert [name for name in sorted(asked) if not hasattr(oracle, name)] == []
