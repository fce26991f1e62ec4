"""A daemon with a fake link, a fake camera and a real worker process, for tests."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from visloc_companion.adapters.camera.calibration import camera_model
from visloc_companion.adapters.systemd.notify import Notifier
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.app.first_position import At
from visloc_companion.app.journal import Entry, read_journal
from visloc_companion.app.live import Daemon, run_daemon
from visloc_companion.app.parts import Constructors
from visloc_companion.config import Config, parse_config
from visloc_companion.errors import CameraError
from visloc_companion.protocols import Camera, Clock, FrameSlots
from visloc_companion.testing.fake_link import FakeLink
from visloc_companion.types import (
    Attitude,
    CameraModel,
    FrameRef,
    GeoPoint,
    Gnss,
    LocalPose,
    PriorPose,
)

HOME = GeoPoint(47.0, 8.0, 600.0)


LENS = {"width_px": 64, "height_px": 48, "fx_px": 500.0, "fy_px": 500.0, "cx_px": 31.5, "cy_px": 23.5}


@dataclass
class FakeCamera:
    """Frames at a rate; does what its plan says after `n_frames`: end, break, hang."""

    config: Config
    clock: Clock
    period_s: float = 0.02
    n_frames: int = 10**9
    then: str = "end"
    closed: bool = False
    lost: dict[str, int] = field(default_factory=dict)

    def model(self) -> CameraModel:
        return camera_model(self.config.camera)

    def left_out(self) -> dict[str, int]:
        return self.lost

    async def frames(self, slots: FrameSlots) -> AsyncIterator[FrameRef]:
        model = self.model()
        for n in range(self.n_frames):
            await asyncio.sleep(self.period_s)
            slot = slots.write(np.full((model.height_px, model.width_px), n % 256, np.uint8))
            now_ns = self.clock.now_ns()
            yield FrameRef(now_ns, now_ns, n, slot, model.width_px, model.height_px, 1)
        if self.then == "break":
            raise CameraError("the cable came out", where="camera")
        if self.then == "hang":
            await asyncio.Event().wait()

    async def close(self) -> None:
        self.closed = True


@dataclass
class FakeNotifier(Notifier):
    """Notes what systemd would be told."""

    said: list[str] = field(default_factory=list)
    watchdog_s: float | None = None

    def _send(self, message: str) -> bool:
        self.said.append(message)
        return True


@dataclass
class Flight:
    daemon: Daemon
    link: FakeLink
    cameras: list[FakeCamera]
    notifier: FakeNotifier
    stop: asyncio.Event
    clock: Clock
    events: list[object] = field(default_factory=list)

    async def until(self, happened: Callable[[], object], why: str) -> None:
        """Wait for something that must come; a minute is for slow machines."""
        try:
            async with asyncio.timeout(60):
                while not happened():  # noqa: ASYNC110 - what is waited for happens in other places
                    await asyncio.sleep(0.01)
        except TimeoutError:
            pytest.fail(f"did not happen: {why}")


def configuration(tmp_path: Path, **sections: dict[str, Any]) -> Config:
    base: dict[str, Any] = {
        "camera": {"url": "fake:1", **LENS},
        "map": {"pack": str(tmp_path)},
        "journal": {"folder": str(tmp_path / "journals")},
        "injection": {"policy": "always"},
    }
    for name, values in sections.items():
        base[name] = base.get(name, {}) | values
    return parse_config(base)


def constructors(link: FakeLink, cameras: list[Any], answers: str, opens_s: float = 0.0, **camera: Any) -> Constructors:
    """`camera`: the plan of the first camera; each takes `opens_s` to open."""

    def make_camera(config: Config, clock: Clock) -> Camera:
        time.sleep(opens_s)
        cameras.append(FakeCamera(config, clock, **(camera if not cameras else {})))
        made: Camera = cameras[-1]
        return made

    return Constructors(lambda *_: link, make_camera, f"answers:{answers}")


@asynccontextmanager
async def flight(
    config: Config, answers: str = "prior_is_right", at: At | None = None, armed: bool = False, **camera: Any
) -> AsyncIterator[Flight]:
    clock, stop, cameras = MonotonicClock(), asyncio.Event(), list[Any]()
    link, notifier = FakeLink(clock, origin=HOME, armed=armed), FakeNotifier()
    ready: asyncio.Future[Daemon] = asyncio.get_running_loop().create_future()
    task = asyncio.create_task(
        run_daemon(
            config,
            stop=stop,
            clock=clock,
            make=constructors(link, cameras, answers, **camera),
            notifier=notifier,
            on_ready=ready.set_result,
            at=at,
        )
    )
    try:
        await asyncio.wait({task, ready}, return_when=asyncio.FIRST_COMPLETED, timeout=60)
        if task.done():
            task.result()
        yield Flight(ready.result(), link, cameras, notifier, stop, clock)
    finally:
        stop.set()
        await task


async def hover(f: Flight) -> None:
    """An autopilot that hovers 100 m over home with good GNSS."""
    while True:
        now = f.clock.now_ns()
        boot = now - 7_000_000_000
        place = GeoPoint(HOME.lat_deg, HOME.lon_deg, HOME.h_amsl_m + 100)
        f.link.feed(
            Attitude(now, boot, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
            PriorPose(now, boot, place, (0.0, 0.0, 0.0), 100.0),
            LocalPose(now, boot, (0.0, 0.0, -100.0), (0.0, 0.0, 0.0)),
            Gnss(now, boot, 3, 15, place, 1.0, 1.5, (0.0, 0.0, 0.0)),
        )
        await asyncio.sleep(0.05)


@asynccontextmanager
async def hovering(f: Flight) -> AsyncIterator[None]:
    task = asyncio.create_task(hover(f))
    try:
        yield
    finally:
        task.cancel()


def entries(config: Config) -> list[Entry]:
    (path,) = Path(config.journal.folder).glob("*.mcap")
    return list(read_journal(path, salvage=False))


def events_of(kind: type, recorded: list[Entry]) -> list[Any]:
    return [entry.event for entry in recorded if isinstance(entry.event, kind)]


def commands_of(kind: type, recorded: list[Entry]) -> list[Any]:
    return [entry.command for entry in recorded if isinstance(entry.command, kind)]
