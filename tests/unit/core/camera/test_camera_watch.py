from __future__ import annotations

import pytest

from visloc_companion.core.camera.camera_watch import FIRST_FRAME_NS, MAX_AHEAD_NS, SILENCE_NS, CameraWatch
from visloc_companion.core.requests import MAX_FRAME_AGE_NS
from visloc_companion.core.terrain.terrain_aiding import METHOD as TERRAIN
from visloc_companion.errors import Reason
from visloc_companion.types import FrameRef, NoFix, Notice


def texts(commands: list) -> list[str]:
    return [c.text for c in commands if isinstance(c, Notice)]


def test_a_picture_that_is_repeated_is_not_new_unless_nobody_looked() -> None:
    watch = CameraWatch()
    seen = [watch.is_new(FrameRef(0, 0, k, 0, 64, 48, 3, checksum=c)) for k, c in enumerate((7, 7, 8, 7, 7, None, None, 7))]
    assert seen == [True, False, True, True, False, True, True, True]


def stamped(number: int, t_boot_s: float | None) -> FrameRef:
    boot_ns = None if t_boot_s is None else round(t_boot_s * 1e9)
    return FrameRef(number, number, number, 0, 64, 48, 3, t_boot_ns=boot_ns, checksum=number)


def test_of_frames_that_bear_one_time_only_the_first_counts() -> None:
    """Stamps in whole seconds: the last frame of each was taken almost a second after the time it bears."""
    watch = CameraWatch()
    seen = [watch.is_new(stamped(k, int(0.2 * k))) for k in range(15)]
    assert [k for k, new in enumerate(seen) if new] == [0, 5, 10]
    assert all(watch.is_new(stamped(k, t_s)) for k, t_s in enumerate((3.0, 2.9, 3.0, None, None, 3.0), start=20)), (
        "but one before"
    )


def test_stamps_that_stand_still_are_told() -> None:
    watch = CameraWatch()
    for k in range(4):
        if watch.is_new(stamped(k, 60.0)):
            watch.on_frame(k * 10**9, k * 10**9)
    assert texts(watch.check(4 * 10**9)) == ["visloc: camera stamps stand still, unused"]
    assert watch.is_new(stamped(5, 65.0))
    assert texts(watch.on_frame(5 * 10**9, 5 * 10**9) or []) == ["camera frames are back"]


def test_a_camera_that_is_not_configured_is_not_missed() -> None:
    watch = CameraWatch()
    assert watch.check(0) == watch.check(10 * FIRST_FRAME_NS) == []


def test_a_configured_camera_that_never_spoke_is_told_once_the_operator_can_hear_of_it() -> None:
    watch = CameraWatch(expected=True)
    heard_ns = 10 * FIRST_FRAME_NS
    assert watch.check(0, heard=False) == watch.check(heard_ns - 1, heard=False) == []
    assert watch.check(heard_ns) == watch.check(heard_ns + FIRST_FRAME_NS) == []
    late_ns = heard_ns + FIRST_FRAME_NS + 1
    assert texts(watch.check(late_ns)) == ["visloc: no camera frames yet"]
    assert watch.check(2 * late_ns) == []
    assert texts(watch.on_frame(2 * late_ns, 2 * late_ns) or []) == ["camera frames are back"]


@pytest.mark.parametrize(
    ("age_s", "told"),
    [
        (3.2, "visloc: camera frames 3 s old, unused"),
        (-363.0, "visloc: camera frames 363 s ahead, unused"),
        (-1.8e9, "visloc: camera stamps of another clock, unused"),
    ],
)
def test_frames_of_another_time_are_none_and_the_operator_is_told_why(age_s: float, told: str) -> None:
    watch = CameraWatch()
    watch.on_frame(0, 0)
    for t_s in range(1, 5):
        assert watch.on_frame(t_s * 10**9, round((t_s - age_s) * 1e9)) is None
        said = texts(watch.check(t_s * 10**9))
        assert said == ([told] if t_s == 3 else [])
    assert len(told) <= 50


def test_a_frame_within_reach_counts() -> None:
    watch = CameraWatch()
    assert watch.on_frame(MAX_FRAME_AGE_NS, 0) == watch.on_frame(0, MAX_AHEAD_NS) == []


def answered(t_s: float, reason: Reason, method: str = "deep") -> NoFix:
    t_ns = round(t_s * 1e9)
    return NoFix(t_ns, t_ns, 1, 1, method, reason, 1.0)


def test_a_picture_that_stands_still_is_told_once_and_so_is_its_end() -> None:
    watch = CameraWatch()
    assert watch.on_answer(answered(10.0, Reason.NO_MATCH)) == watch.on_answer(answered(10.5, Reason.FROZEN)) == []
    assert watch.check(10_500_000_000 + SILENCE_NS) == []
    told = watch.check(10_500_000_001 + SILENCE_NS)
    assert texts(told) == ["visloc: camera picture stands still, unused"]
    assert told[0].to_operator
    assert len(texts(told)[0]) <= 50
    assert watch.on_answer(answered(13.0, Reason.FROZEN)) == watch.check(20 * SILENCE_NS) == []
    assert watch.on_answer(answered(13.2, Reason.NO_MATCH, TERRAIN)) == []
    assert texts(watch.on_answer(answered(13.5, Reason.NO_MATCH))) == ["camera frames are back"]
    assert watch.on_answer(answered(14.0, Reason.NO_MATCH)) == watch.check(30 * SILENCE_NS) == []


def test_a_single_picture_that_seemed_to_stand_still_is_not_told() -> None:
    watch = CameraWatch()
    for t_s in range(10):
        assert watch.on_answer(answered(t_s, Reason.FROZEN if t_s % 2 else Reason.NO_MATCH)) == []
        assert watch.check(t_s * 10**9 + 10**9 - 1) == []


def test_silence_is_told_once_and_so_is_its_end() -> None:
    watch = CameraWatch()
    assert watch.on_frame(0, 0) == []
    assert watch.check(SILENCE_NS) == []
    assert texts(watch.check(SILENCE_NS + 1)) == ["visloc: no new camera frames"]
    assert watch.check(3 * SILENCE_NS) == []
    assert texts(watch.on_frame(3 * SILENCE_NS, 3 * SILENCE_NS) or []) == ["camera frames are back"]
    assert watch.on_frame(3 * SILENCE_NS + 1, 3 * SILENCE_NS) == []
    assert texts(watch.check(6 * SILENCE_NS)) == ["visloc: no new camera frames"]


COMES_AND_GOES = ["visloc: no new camera frames", "camera frames are back"] * 2


def heard(watch: CameraWatch, frames_s: list[float], until_s: float) -> list[str]:
    """What is said, a Tick each 0.1 s, of frames that arrive at these times."""
    told: list[str] = []
    waiting = sorted(frames_s)
    for tick in range(round(until_s * 10) + 1):
        while waiting and waiting[0] <= tick / 10:
            at_ns = round(waiting.pop(0) * 1e9)
            told += texts(watch.on_frame(at_ns, at_ns) or [])
        told += texts(watch.check(tick * 10**8))
    return told


@pytest.mark.parametrize("period_s", [2.3, 4.0, 9.0, 15.0])
def test_frames_that_come_seldom_are_told_once(period_s: float) -> None:
    """A camera slower than a frame in 2 s: the operator read that frames are missing with each of them, and nothing else."""
    told = heard(CameraWatch(), [k * period_s for k in range(100)], 99 * period_s)
    assert told == [*COMES_AND_GOES, f"visloc: camera frames {period_s:.0f} s apart"]
    assert len(told[-1]) <= 50


def test_frames_about_the_limit_apart_are_told_once() -> None:
    times, at_s = [], 0.0
    for k in range(100):
        times.append(at_s)
        at_s += 1.9 if k % 2 else 2.2
    assert heard(CameraWatch(), times, at_s - 1.0) == [*COMES_AND_GOES, "visloc: camera frames 2 s apart"]


def test_frames_that_come_often_again_are_told_once() -> None:
    often = [40.0 + 0.5 * k for k in range(60)]
    told = heard(CameraWatch(), [4.0 * k for k in range(10)] + often, 69.5)
    assert told[4:] == ["visloc: camera frames 4 s apart", "camera frames are back"]


def test_seldom_frames_that_stop_are_told() -> None:
    watch = CameraWatch()
    told = heard(watch, [4.0 * k for k in range(10)], 60.0)
    assert told[4:] == ["visloc: camera frames 4 s apart", "visloc: no new camera frames"]
    assert texts(watch.on_frame(60 * 10**9, 60 * 10**9) or []) == ["camera frames are back"]


def test_two_gaps_far_from_each_other_are_told_each() -> None:
    times = [0.5 * k for k in range(200) if not (20 < 0.5 * k < 25 or 60 < 0.5 * k < 65)]
    assert heard(CameraWatch(), times, 99.0) == COMES_AND_GOES


def outages(*ends_s: tuple[float, float], until_s: float = 60.0) -> list[float]:
    """Times of a camera of 2.5 frames a second that is away between these."""
    times = [0.4 * k for k in range(round(until_s / 0.4))]
    return [t_s for t_s in times if not any(begin < t_s < end for begin, end in ends_s)]


def test_a_camera_of_a_good_rate_that_drops_out_again_and_again_is_not_a_slow_one() -> None:
    """It was said of 2.5 frames a second that they come 9 s apart."""
    watch = CameraWatch()
    told = heard(watch, outages((10, 19), (24, 33), (38, 47)), 59.0)
    assert told == [*COMES_AND_GOES, "visloc: camera frames come and go", "camera frames are back"]
    assert not watch.rare


def test_nor_is_the_frame_after_its_outage_a_rare_one() -> None:
    seen: dict[bool, list[bool]] = {True: [], False: []}
    for slow, times in ((True, [9.0 * k for k in range(5)]), (False, outages((10, 19), (24, 33), (38, 47)))):
        watch = CameraWatch()
        for t_s in times:
            watch.on_frame(round(t_s * 1e9), round(t_s * 1e9))
            seen[slow].append(watch.rare)
    assert seen[True] == [False, False, True, True, True]
    assert not any(seen[False])
