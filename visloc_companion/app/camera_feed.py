"""Frames for as long as the daemon runs: a camera that breaks or falls silent is opened again."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections import Counter
from collections.abc import AsyncGenerator, Callable
from dataclasses import replace

from visloc_companion.app.parts import MakeCamera, Parts
from visloc_companion.errors import CameraError, ConfigError, PictureSizeError
from visloc_companion.protocols import Camera, FrameSlots
from visloc_companion.types import FrameRef, Notice, Severity

STALL_S = 5.0
RETRY_S = 2.0
OPEN_S = 60.0
"""A network camera's library takes half a minute to find that nobody answers."""
TELL_S = 60.0
"""Between two words on frames that are left out, unless the camera breaks."""
OTHER_SIZE = "visloc: camera gives another image size, unused"
"""No more than that no frames come would the operator read of a camera that was set to another size."""


class CameraFeed:
    """`beat` is called on every frame and every attempt, also on one that hangs while positions are `relied_on`; `report` gets
    one notice for each reason of an outage, and says how many frames were left out, and why. `parts.camera` is the open one."""

    def __init__(
        self,
        parts: Parts,
        slots: FrameSlots,
        make_camera: MakeCamera,
        report: Callable[[Notice], None],
        beat: Callable[[], None],
        relied_on: Callable[[], bool] = lambda: False,
    ) -> None:
        self._parts, self._slots, self._make_camera = parts, slots, make_camera
        self._report, self._beat, self._relied_on = report, beat, relied_on
        self._first_id = self._last_id = 0
        self._told: set[str] = set()
        self._left_out, self._left_out_before = Counter[str](), Counter[str]()
        self._tell_at_s = -math.inf

    async def frames(self) -> AsyncGenerator[FrameRef, None]:
        """Frames, numbered through. Ends with the end of a recording."""
        while self._parts.camera is not None:
            try:
                async with contextlib.aclosing(self._until_trouble(self._parts.camera)) as frames:
                    async for frame in frames:
                        yield frame
            except (CameraError, OSError) as why:  # TimeoutError is one
                self._complain(why)
            else:
                self._count(self._parts.camera, at_once=True)
                self._report(Notice(Severity.NOTICE, "the camera's recording has ended"))
                return
            self._count(self._parts.camera, at_once=True)
            await self._open_again(self._parts.camera)

    async def _until_trouble(self, camera: Camera) -> AsyncGenerator[FrameRef, None]:
        async with contextlib.aclosing(_generator(camera, self._slots)) as frames:
            while True:
                try:
                    async with asyncio.timeout(STALL_S):
                        frame = await anext(frames)
                except StopAsyncIteration:
                    return
                self._told.clear()
                self._beat()
                self._count(camera)
                self._last_id = self._first_id + frame.frame_id  # a camera that was opened again counts from its start
                yield replace(frame, frame_id=self._last_id)

    def _complain(self, why: Exception) -> None:
        trouble = str(why) or f"no frame for {STALL_S:g} s"
        if trouble not in self._told:
            self._told.add(trouble)
            of_size = isinstance(why, PictureSizeError)
            text = OTHER_SIZE if of_size else "camera is opened again"
            self._report(Notice(Severity.WARNING, text, to_operator=of_size, data=(("why", trouble),)))

    def _count(self, camera: Camera, at_once: bool = False) -> None:
        """Say how many frames were left out so far, where they have become more."""
        left_out, now_s = self._left_out_before + Counter(camera.left_out()), asyncio.get_running_loop().time()
        if left_out != self._left_out and (at_once or now_s >= self._tell_at_s):
            self._left_out, self._tell_at_s = left_out, now_s + TELL_S
            data = tuple((why, float(n)) for why, n in left_out.items())
            self._report(Notice(Severity.WARNING, "camera frames were left out", data=data))

    async def _open_again(self, camera: Camera) -> None:
        self._first_id = self._last_id + 1
        self._left_out_before = self._left_out
        with contextlib.suppress(CameraError):
            await camera.close()
        while True:
            self._beat()
            await asyncio.sleep(RETRY_S)
            try:
                self._parts.camera = await self._opened()
            except (CameraError, ConfigError, OSError) as why:
                # gone, there under another name, its mask lay on what came out with it, or no descriptor is left to look
                self._complain(why)
            else:
                return

    async def _opened(self) -> Camera:
        """A new camera, opened in a thread: the flight goes on meanwhile. Beats for as long as that may take, and while positions
        are sent: a daemon that is started again waits for the camera as well, and sends none."""
        opening = asyncio.create_task(asyncio.to_thread(self._make_camera, self._parts.config, self._parts.clock))
        try:
            begun_s = asyncio.get_running_loop().time()
            while not opening.done() and (asyncio.get_running_loop().time() - begun_s < OPEN_S or self._relied_on()):
                self._beat()
                await asyncio.wait({opening}, timeout=RETRY_S)
            return await opening
        finally:
            opening.cancel()


async def _generator(camera: Camera, slots: FrameSlots) -> AsyncGenerator[FrameRef, None]:
    async for frame in camera.frames(slots):
        yield frame
