from __future__ import annotations

from visloc_companion.core.camera_watch import SILENCE_NS, CameraWatch
from visloc_companion.types import FrameRef, Notice


def texts(commands: list) -> list[str]:
    return [c.text for c in commands if isinstance(c, Notice)]


def test_a_picture_that_is_repeated_is_not_new_unless_nobody_looked() -> None:
    watch = CameraWatch()
    seen = [watch.is_new(FrameRef(0, 0, k, 0, 64, 48, 3, checksum=c)) for k, c in enumerate((7, 7, 8, 7, 7, None, None, 7))]
    assert seen == [True, False, True, True, False, True, True, True]


def test_a_camera_that_never_spoke_is_not_missed() -> None:
    assert CameraWatch().check(10 * SILENCE_NS) == []


def test_silence_is_told_once_and_so_is_its_end() -> None:
    watch = CameraWatch()
    assert watch.on_frame(0) == []
    assert watch.check(SILENCE_NS) == []
    assert texts(watch.check(SILENCE_NS + 1)) == ["visloc: no new camera frames"]
    assert watch.check(3 * SILENCE_NS) == []
    assert texts(watch.on_frame(3 * SILENCE_NS)) == ["camera frames are back"]
    assert watch.on_frame(3 * SILENCE_NS + 1) == []
    assert texts(watch.check(6 * SILENCE_NS)) == ["visloc: no new camera frames"]
