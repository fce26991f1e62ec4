"""What an operator is told of a gimbal, and when not."""

from __future__ import annotations

from visloc_companion.core.camera.gimbal_watch import GimbalWatch
from visloc_companion.errors import Reason
from visloc_companion.types import Notice, Severity

S = 1_000_000_000


def said(watch: GimbalWatch, t_s: float, *, heard: bool = True, needed: bool = False) -> list[tuple[Severity, str]]:
    told = watch.check(round(t_s * S), heard=heard, needed=needed)
    return [(c.severity, c.text) for c in told if isinstance(c, Notice)]


def test_while_the_autopilot_is_not_heard_nothing_is_said_and_no_time_counts() -> None:
    watch = GimbalWatch()
    assert [text for k in range(100) for text in said(watch, k * 0.1, heard=False)] == []
    assert said(watch, 10.0) == said(watch, 12.9) == []
    assert said(watch, 13.1) == [(Severity.WARNING, "visloc: no gimbal attitude")]
    assert said(watch, 20.0) == []
    watch.heard(21 * S)
    assert said(watch, 21.0) == [(Severity.NOTICE, "visloc: gimbal attitude is back")]


def test_what_was_between_frames_that_are_far_apart_nobody_knows() -> None:
    """A frame at the horizon, a landing, a frame at the horizon: it may have looked down meanwhile."""
    watch = GimbalWatch()
    watch.judged(Reason.HORIZON_IN_VIEW, 1 * S)
    watch.heard(10 * S)
    watch.judged(Reason.HORIZON_IN_VIEW, 10 * S)
    assert said(watch, 10.5) == []
    for k in range(8):
        watch.judged(Reason.GIMBAL_TURNING, (10 + k) * S)
        watch.heard((10 + k) * S)
    assert said(watch, 17.0) == [(Severity.NOTICE, "visloc: gimbal looks away from the ground")]


def test_that_nobody_says_where_it_points_is_no_look_away() -> None:
    watch = GimbalWatch()
    for k in range(8):
        watch.judged(Reason.NO_GIMBAL_ATTITUDE, k * S)
    assert said(watch, 8.0) == []
    assert said(watch, 11.1) == [(Severity.WARNING, "visloc: no gimbal attitude")]


def test_a_warning_is_not_said_again_when_positions_are_needed_no_more() -> None:
    watch = GimbalWatch()
    for k in range(10):
        watch.judged(Reason.HORIZON_IN_VIEW, k * S)
        watch.heard(k * S)
    assert [severity for severity, _ in said(watch, 9.0, needed=True)] == [Severity.WARNING]
    assert said(watch, 9.1, needed=False) == []
    watch.judged(None, 10 * S)
    assert said(watch, 10.0) == [(Severity.NOTICE, "visloc: gimbal looks at the ground again")]


def test_a_word_that_comes_too_rarely_for_the_frames_is_told_once_and_its_end() -> None:
    """Once a second: of five frames one lies within 0.1 s of it."""
    watch, told = GimbalWatch(), []
    for k in range(150):
        rare = k < 60
        if k % 5 == 0 or not rare:
            watch.heard(k * S // 5)
        watch.judged(Reason.NO_GIMBAL_ATTITUDE if rare and k % 5 else None, k * S // 5)
        told += [(k, *each) for each in said(watch, k / 5)]
    assert [(severity, text) for _, severity, text in told] == [
        (Severity.WARNING, "visloc: gimbal attitude too rare or late"),
        (Severity.NOTICE, "visloc: gimbal attitude comes in time again"),
    ]
    assert told[0][0] < 25
    assert 60 < told[1][0] < 85


def test_of_a_gimbal_that_is_silent_only_the_silence_is_told() -> None:
    watch, told = GimbalWatch(), []
    for k in range(100):
        if k < 5:
            watch.heard(k * S // 5)
        watch.judged(Reason.NO_GIMBAL_ATTITUDE if k >= 5 else None, k * S // 5)
        told += [text for _, text in said(watch, k / 5)]
    assert told == ["visloc: no gimbal attitude"]


def test_single_frames_between_two_words_are_nothing_to_speak_of() -> None:
    watch = GimbalWatch()
    for k in range(100):
        watch.heard(k * S // 5)
        watch.judged(Reason.NO_GIMBAL_ATTITUDE if k % 4 == 0 else None, k * S // 5)
        assert said(watch, k / 5) == []


def test_a_frame_that_is_asked_about_again_and_again_counts_once() -> None:
    watch = GimbalWatch()
    for k in range(40):
        watch.heard(k * S // 5)
        for _ in range(9):  # its time is beyond the newest word
            watch.judged(Reason.NO_GIMBAL_ATTITUDE, k * S // 5, frame_ns=k)
        watch.judged(None, k * S // 5, frame_ns=k)
        assert said(watch, k / 5) == []
