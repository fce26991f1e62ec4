"""What the log says of a camera that does not come back."""

from __future__ import annotations

import contextlib
import errno
import time
from collections.abc import AsyncIterator
from itertools import pairwise
from pathlib import Path
from threading import Event, Timer
from typing import cast

import pytest

from tests.unit.app.daemon import FakeCamera, configuration
from visloc_companion.app import camera_feed
from visloc_companion.app.camera_feed import CameraFeed
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.app.parts import Parts
from visloc_companion.app.slots import SharedFrameSlots
from visloc_companion.config import Config
from visloc_companion.errors import CameraError, ConfigError, PictureSizeError, VislocError
from visloc_companion.protocols import Camera, Clock, FrameSlots
from visloc_companion.types import FrameRef, Notice

GONE = CameraError("cannot be opened", where="/dev/video0", remedy="check the name")
NO_MASK = ConfigError("cannot be read: No such file or directory", where="camera.mask = /media/card/mask.png")
NO_DESCRIPTOR = OSError(errno.EMFILE, "Too many open files", "/proc")


class Flown:
    """What of a daemon's parts a feed needs."""

    def __init__(self, camera: FakeCamera) -> None:
        self.config, self.clock, self.camera = camera.config, camera.clock, camera


@pytest.mark.parametrize("refusal", [GONE, NO_MASK, NO_DESCRIPTOR])
async def test_why_a_camera_cannot_be_opened_again_is_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refusal: VislocError | OSError
) -> None:
    """Plugged in anew it has another number, and its mask may have gone with it: that it broke says neither."""
    monkeypatch.setattr(camera_feed, "RETRY_S", 0.02)
    broken = FakeCamera(configuration(tmp_path), MonotonicClock(), n_frames=2, then="break")
    refusals, told = [refusal] * 3, list[str]()

    def make(config: Config, clock: Clock) -> Camera:
        if refusals:
            raise refusals.pop()
        made: Camera = FakeCamera(config, clock, n_frames=2)
        return made

    def report(notice: Notice) -> None:
        told.extend(str(value) for name, value in notice.data if name == "why")

    with SharedFrameSlots(broken.model()) as slots:
        feed = CameraFeed(cast("Parts", Flown(broken)), slots, make, report, lambda: None)
        async with contextlib.aclosing(feed.frames()) as frames:
            ids = [frame.frame_id async for frame in frames]
    assert told == ["camera: the cable came out", str(refusal)]
    assert ids == [0, 1, 2, 3]


async def test_frames_that_are_left_out_are_told_with_why_and_how_many(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At once, then now and then, and the rest when the camera breaks; a camera that is opened again counts on."""
    monkeypatch.setattr(camera_feed, "RETRY_S", 0.02)
    monkeypatch.setattr(camera_feed, "TELL_S", 0.1)
    cameras = [FakeCamera(configuration(tmp_path), MonotonicClock(), n_frames=3, then="break", lost={"late": 2, "torn": 0})]
    told = list[dict[str, float | str]]()

    def make(config: Config, clock: Clock) -> Camera:
        cameras.append(FakeCamera(config, clock, n_frames=20))
        made: Camera = cameras[-1]
        return made

    def report(notice: Notice) -> None:
        if notice.text == "camera frames were left out":
            told.append(dict(notice.data))

    with SharedFrameSlots(cameras[0].model()) as slots:
        feed = CameraFeed(cast("Parts", Flown(cameras[0])), slots, make, report, lambda: None)
        async with contextlib.aclosing(feed.frames()) as frames:
            n = 0
            async for _ in frames:
                n += 1
                lost = cameras[-1].lost
                lost["torn" if len(cameras) == 1 else "late"] = n
    assert told[0] == {"late": 2.0}
    assert told[1] == {"late": 2.0, "torn": 3.0}
    assert told[-1] == {"late": 2.0 + 23, "torn": 3.0}
    assert 4 <= len(told) <= 8, "now and then, not with each of the twenty frames"


@pytest.mark.parametrize("relied_on", [True, False])
async def test_an_opening_that_hangs_ends_no_positions_that_go_on_without_the_camera(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, relied_on: bool
) -> None:
    """The watchdog ends a daemon whose camera does not beat; the next one would wait for the same camera."""
    monkeypatch.setattr(camera_feed, "RETRY_S", 0.02)
    monkeypatch.setattr(camera_feed, "OPEN_S", 0.2)
    broken, go_on, beats = FakeCamera(configuration(tmp_path), MonotonicClock(), n_frames=2, then="break"), Event(), list[float]()

    def make(config: Config, clock: Clock) -> Camera:
        assert go_on.wait(30)
        made: Camera = FakeCamera(config, clock, n_frames=2)
        return made

    def beat() -> None:
        beats.append(time.monotonic())

    with SharedFrameSlots(broken.model()) as slots:
        feed = CameraFeed(cast("Parts", Flown(broken)), slots, make, lambda _: None, beat, lambda: relied_on)
        Timer(1.0, go_on.set).start()
        async with contextlib.aclosing(feed.frames()) as frames:
            ids = [frame.frame_id async for frame in frames]
    assert ids == [0, 1, 2, 3]
    assert (max(after - before for before, after in pairwise(beats)) < 0.4) == relied_on


async def test_the_operator_is_told_of_a_camera_that_gives_another_size_and_it_comes_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That no frames come would be all to read; the log has both sizes."""
    monkeypatch.setattr(camera_feed, "RETRY_S", 0.02)
    turned = FakeCamera(configuration(tmp_path), MonotonicClock(), n_frames=2, then="break")
    told: list[Notice] = []
    plans = [0, 0, 2]

    class Turned(FakeCamera):
        async def frames(self, slots: FrameSlots) -> AsyncIterator[FrameRef]:
            async for frame in super().frames(slots):
                yield frame
            if self.n_frames == 0:
                raise PictureSizeError("image is 48x64, the calibration is for 64x48", where="camera")

    def make(config: Config, clock: Clock) -> Camera:
        made: Camera = Turned(config, clock, n_frames=plans.pop(0))
        return made

    with SharedFrameSlots(turned.model()) as slots:
        feed = CameraFeed(cast("Parts", Flown(turned)), slots, make, told.append, lambda: None)
        async with contextlib.aclosing(feed.frames()) as frames:
            assert [frame.frame_id async for frame in frames] == [0, 1, 2, 3]
    said = [notice for notice in told if notice.to_operator]
    assert [(notice.text, notice.data) for notice in said] == [
        ("visloc: camera gives another image size, unused", (("why", "camera: image is 48x64, the calibration is for 64x48"),))
    ]
