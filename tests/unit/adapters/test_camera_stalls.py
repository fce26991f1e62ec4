"""Cameras that stop for a while: what they kept meanwhile is late, and a read that does not return still has the device."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from typing import Any

import numpy as np
import pytest

from tests.unit.adapters.test_camera_sources import MODEL, JumpingClock, Slots, WallClock, all_of, picture
from visloc_companion.adapters.camera import device
from visloc_companion.adapters.camera.after_stall import AfterStall
from visloc_companion.adapters.camera.device import DeviceCamera
from visloc_companion.adapters.camera.tcp import StreamedFrame, TcpCamera, encode_frame
from visloc_companion.core.camera.frame_clock import FrameClock
from visloc_companion.errors import CameraError

LATE_S = 0.02


def arrivals_s(period_s: float, stall_s: float, n_before: int = 60, n_after: int = 120) -> tuple[list[float], list[float]]:
    """When frames are taken and when they arrive, the connection being held up for a while after so many of them."""
    taken = [k * period_s for k in range(n_before + n_after)]
    back_s = taken[n_before - 1] + stall_s
    arrive: list[float] = []
    for k, t_s in enumerate(taken):
        due_s = t_s + LATE_S if k < n_before else max(t_s + LATE_S, back_s)
        arrive.append(max(due_s, arrive[-1] + 0.001) if arrive else due_s)
    return taken, arrive


class HeldUp:
    """A device that gives frames when they arrive, and then none; the picture's red is the frame's number."""

    def __init__(self, clock: JumpingClock, arrive_s: list[float]) -> None:
        self.clock, self.start_ns, self.arrive_s, self.n = clock, clock.t_ns, arrive_s, 0

    def read(self) -> tuple[bool, Any]:
        if self.n == len(self.arrive_s):
            return False, None
        self.clock.t_ns = self.start_ns + round(self.arrive_s[self.n] * 1e9)
        self.n += 1
        return True, picture(self.n - 1)[:, :, ::-1]

    def release(self) -> None:
        pass


@pytest.mark.parametrize(("period_s", "stall_s"), [(1 / 30, 0.5), (1 / 30, 1.5), (0.25, 1.5), (0.1, 4.0)])
async def test_what_a_device_kept_while_it_stalled_is_not_taken_for_new(period_s: float, stall_s: float) -> None:
    """Taken as they come, frames of the stall would bear a time that is late by all of it, and claim a millisecond."""
    taken, arrive = arrivals_s(period_s, stall_s)
    clock, slots, even = JumpingClock(), Slots(), FrameClock()
    start_ns = clock.t_ns
    camera = DeviceCamera("rtsp://cam", MODEL, clock, capture=HeldUp(clock, arrive))
    late_s, numbers = [], []
    with pytest.raises(CameraError, match="gives no frames"):
        async for frame in camera.frames(slots):
            numbers.append(int(slots.read(frame)[0, 0, 0]))
            found = even.on_arrival(frame.t_ns, frame.frame_id)
            late_s.append((found.t_ns - start_ns) * 1e-9 - taken[numbers[-1]] - LATE_S)
    assert max(map(abs, late_s)) < 0.005
    assert camera.waited == len(taken) - len(numbers) <= stall_s / period_s + 2
    assert even.jumps == (1 if stall_s > 2 else 0), "numbers that go on keep the phase of the frames' clock"


@pytest.mark.parametrize("spread_s", [0.0, 0.2])
def test_an_even_camera_loses_no_frame_to_jitter(spread_s: float) -> None:
    rng = np.random.default_rng(5)
    for period_s in (1 / 30, 0.2, 2.0):
        fresh = AfterStall()
        arrive = np.maximum.accumulate(np.arange(300) * period_s + rng.uniform(0, spread_s, 300))
        assert all(fresh.is_fresh(round(t_s * 1e9)) for t_s in arrive)


@pytest.mark.parametrize("stall_s", [0.7, 1.5])
def test_a_camera_that_is_faster_after_a_stall_is_used_again_once_nothing_can_have_waited(stall_s: float) -> None:
    """It came out of the dark, or its process was started anew: from 5 to 30 frames a second."""
    fresh = AfterStall()
    before_s = np.arange(40) * 0.2
    back_s = before_s[-1] + stall_s
    after_s = back_s + np.arange(1, 120) / 30
    assert all(fresh.is_fresh(round(t_s * 1e9)) for t_s in before_s)
    used_s = [t_s for t_s in (back_s, *after_s) if fresh.is_fresh(round(t_s * 1e9))]
    assert back_s + 0.9 * stall_s < used_s[0] <= back_s + stall_s + 0.04
    assert len(used_s) > 60, "and stays in use"


def test_a_camera_that_becomes_slower_is_followed() -> None:
    """At dusk a camera exposes for longer: its gaps are no stalls for long."""
    arrive = np.cumsum([1 / 30] * 60 + [0.3] * 40)
    fresh = AfterStall()
    seen = [fresh.is_fresh(round(t_s * 1e9)) for t_s in arrive]
    assert all(seen[:60])
    assert seen[60:].count(False) <= 3
    assert all(seen[-30:])


@pytest.mark.parametrize("autopilot_clock", [False, True])
async def test_frames_of_a_stream_that_stalled_count_by_their_own_time_or_not_at_all(autopilot_clock: bool) -> None:
    _, arrive = arrivals_s(0.1, 1.0, n_before=12, n_after=12)
    clock, slots, numbers, heard = JumpingClock(), Slots(), list[int](), asyncio.Event()
    start_ns = clock.t_ns

    async def serve(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        for k, t_s in enumerate(arrive):
            clock.t_ns = start_ns + round(t_s * 1e9)
            writer.write(encode_frame(StreamedFrame(picture(k), k * 1000, autopilot_clock)))
            while camera.skipped + camera.waited + len(numbers) <= k:  # noqa: ASYNC110 - each arrives alone
                await asyncio.sleep(0.001)
        heard.set()
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    camera = TcpCamera(f"127.0.0.1:{server.sockets[0].getsockname()[1]}", MODEL, clock)

    async def watch() -> None:
        async for frame in camera.frames(slots):
            numbers.append(int(slots.read(frame)[0, 0, 0]))

    watching = asyncio.create_task(watch())
    async with asyncio.timeout(20.0):
        await heard.wait()
    await camera.close()
    await watching
    server.close()
    await server.wait_closed()
    kept = [k for k, t_s in enumerate(arrive) if k >= 12 and t_s > 0.1 * k + 2 * LATE_S]
    assert len(kept) > 5
    assert set(range(24)) - set(numbers) == (set() if autopilot_clock else {*kept, kept[-1] + 1})
    assert camera.skipped + camera.waited == 24 - len(numbers)


class Stuck:
    """A device whose third read returns only when it is let go."""

    def __init__(self) -> None:
        self.let_go, self.reading, self.n = threading.Event(), False, 0
        self.released: list[str] = []

    def read(self) -> tuple[bool, Any]:
        self.n += 1
        if self.n > 2:
            self.reading = True
            self.let_go.wait(20.0)
            self.reading = False
            return False, None
        return True, picture(self.n)

    def release(self) -> None:
        self.released.append("while it was read" if self.reading else "after")


async def test_a_device_is_not_released_while_it_is_read_but_then_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cable that came out holds a read for ten seconds; the daemon gives the camera up after five."""
    monkeypatch.setattr(device, "RELEASE_PATIENCE_S", 0.05)
    capture = Stuck()
    camera = DeviceCamera("0", MODEL, WallClock(), capture=capture)
    watching = asyncio.create_task(all_of(camera, Slots()))
    async with asyncio.timeout(10.0):
        while not capture.reading:  # noqa: ASYNC110 - another thread begins it
            await asyncio.sleep(0.01)
    watching.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await watching
    await camera.close()
    assert capture.released == [], "the thread is still in it"
    capture.let_go.set()
    async with asyncio.timeout(10.0):
        while not capture.released:  # noqa: ASYNC110 - another thread ends it
            await asyncio.sleep(0.01)
    assert capture.released == ["after"]
