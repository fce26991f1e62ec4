"""Everything real at once: `visloc run` as a process, its worker, a pack, UDP, a camera over TCP, and the built-in autopilot."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import socket
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.unit.processes import gone
from visloc_companion.adapters.camera.calibration import camera_model
from visloc_companion.adapters.camera.framing import StreamedFrame, encode_frame
from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.app.journal import read_frames, read_header, read_journal, read_mavlink
from visloc_companion.app.replay import compare_with_recording
from visloc_companion.cli.toml import to_toml
from visloc_companion.config import Config, parse_config
from visloc_companion.maps.pack import PackMap
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.scene import Scene
from visloc_companion.testing.loopback import free_port
from visloc_companion.types import Attitude, AutopilotKind, Fix, GeoPoint, Injection, WorkerState

HEIGHT_M = 80.0


def configuration(tmp_path: Path, pack: Path) -> Config:
    focal = HEIGHT_M / 0.5
    camera = {"width_px": 240, "height_px": 200, "fx_px": focal, "fy_px": focal, "cx_px": 119.5, "cy_px": 99.5}
    return parse_config(
        {
            "link": {"url": f"udpin:127.0.0.1:{free_port(socket.SOCK_DGRAM)}"},
            "camera": {"url": f"tcp:127.0.0.1:{free_port(socket.SOCK_STREAM)}", **camera},
            "map": {"pack": str(pack)},
            "localiser": {"method": "gradient"},
            "injection": {"policy": "always"},
            "journal": {"folder": str(tmp_path / "journals"), "record_frames": True},
            "status": {"socket": str(tmp_path / "status.sock")},
        }
    )


class World:
    """A copter that hovers over the middle of the map, its autopilot on UDP and its camera on TCP."""

    def __init__(self, config: Config, small_world: Any) -> None:
        self.config = config
        lat, lon = PackMap.open(small_world.pack).to_geo(small_world.east_m + 150.0, small_world.north_m - 150.0)
        home, there = GeoPoint(lat, lon, 0.0), [(0.0, 0.0, -HEIGHT_M), (2.0, 0.0, -HEIGHT_M)]
        self.pilot = BuiltInAutopilot(AutopilotKind.ARDUPILOT, "copter", home, there, 2.0, 3, boot_age_s=30.0)
        self.camera = CameraSimulator(Scene.load(small_world.ortho, None, 0.0), camera_model(config.camera))
        self.injections = 0
        self.landed = False
        self.films: set[asyncio.Task[None] | None] = set()
        self._parser: Any = mav.MAVLink(None)
        self._parser.robust_parsing = True

    async def fly(self) -> None:
        clock = MonotonicClock()
        port = int(self.config.link.url.rpartition(":")[2])
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as radio:
            radio.setblocking(False)
            radio.bind(("127.0.0.1", 0))
            start_ns, flown_s = clock.now_ns(), 0.0
            while True:
                await asyncio.sleep(0.01)
                elapsed_s = (clock.now_ns() - start_ns) / 1e9
                self.pilot.step(elapsed_s - flown_s)
                flown_s = elapsed_s
                data = self.pilot.outgoing()
                with contextlib.suppress(ConnectionError, BlockingIOError):
                    for k in range(0, len(data), 1200):
                        radio.sendto(data[k : k + 1200], ("127.0.0.1", port))
                with contextlib.suppress(ConnectionError, BlockingIOError):
                    while True:
                        self._heard(radio.recv(65535))

    def _heard(self, data: bytes) -> None:
        self.pilot.receive(data)
        messages = self._parser.parse_buffer(data) or []
        self.injections += sum(message.get_type() == "VISION_POSITION_ESTIMATE" for message in messages)

    async def film(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.films.add(asyncio.current_task())
        with contextlib.suppress(ConnectionError):
            while not self.landed:
                truth, t_us = self.pilot.truth(), self.pilot.t_boot_ns // 1000
                pixels = await asyncio.to_thread(self.camera.frame, truth.place, truth.q_ned_frd, 1)
                writer.write(encode_frame(StreamedFrame(pixels, t_us, autopilot_clock=True)))
                await writer.drain()
                await asyncio.sleep(0.2)
        writer.close()


@asynccontextmanager
async def world(config: Config, small_world: Any) -> AsyncIterator[World]:
    made = World(config, small_world)
    server = await asyncio.start_server(made.film, "127.0.0.1", int(config.camera.url.rpartition(":")[2]))
    flying = asyncio.create_task(made.fly())
    try:
        yield made
    finally:
        made.landed = True
        flying.cancel()
        server.close()
        await asyncio.gather(flying, *(film for film in made.films if film), return_exceptions=True)


async def status(config: Config) -> dict[str, Any]:
    try:
        reader, writer = await asyncio.open_unix_connection(config.status.socket)
    except OSError:
        return {}
    answer: dict[str, Any] = json.loads(await reader.read())
    writer.close()
    await writer.wait_closed()
    return answer


async def until(happened: Callable[[], Awaitable[object]], why: str) -> None:
    try:
        async with asyncio.timeout(60):
            while not await happened():  # noqa: ASYNC110
                await asyncio.sleep(0.1)
    except TimeoutError:
        pytest.fail(f"did not happen: {why}")


@pytest.mark.slow
async def test_a_flight_with_a_killed_worker_a_clean_end_and_a_killed_daemon(tmp_path: Path, small_world: Any) -> None:
    config = configuration(tmp_path, small_world.pack)
    path = tmp_path / "visloc.toml"
    path.write_text(to_toml(config.model_dump(mode="json")))
    command = [sys.executable, "-m", "visloc_companion.cli.main", "run", "--config", str(path)]

    async def worker_pid() -> int:
        worker = (await status(config)).get("worker") or {}
        return int(worker.get("pid") or 0) if worker.get("up") else 0

    async with world(config, small_world) as w:

        async def fixes() -> bool:
            state = (await status(config)).get("status") or {}
            return state.get("age_of_fix_s") is not None and state["age_of_fix_s"] < 2.0

        daemon = await asyncio.create_subprocess_exec(*command, stderr=asyncio.subprocess.PIPE)
        assert daemon.stderr is not None
        await until(fixes, "a fresh fix")
        first = await worker_pid()
        os.kill(first, signal.SIGKILL)

        async def another() -> bool:
            return await worker_pid() not in (0, first)

        await until(another, "another worker")
        await until(fixes, "a fresh fix of the other worker")
        second, n = await worker_pid(), w.injections
        await until(lambda: asyncio.sleep(0.1, w.injections >= n + 10), "injections that the autopilot hears")
        daemon.send_signal(signal.SIGTERM)
        messages = (await daemon.stderr.read()).decode()
        assert await daemon.wait() == 0, messages
        assert "resource_tracker" not in messages
        assert "Traceback" not in messages
        assert gone(second)
        silent = w.injections
        await asyncio.sleep(0.3)
        assert w.injections == silent

        daemon = await asyncio.create_subprocess_exec(*command, stderr=asyncio.subprocess.PIPE)
        await until(worker_pid, "a worker")
        third = await worker_pid()
        daemon.send_signal(signal.SIGKILL)
        assert await daemon.wait() == -signal.SIGKILL
        await until(lambda: asyncio.sleep(0.1, gone(third)), "the end of the worker of a killed daemon")

    whole, killed = sorted((tmp_path / "journals").glob("*.mcap"))
    entries = list(read_journal(whole, salvage=False))
    states = [entry.event for entry in entries if isinstance(entry.event, WorkerState)]
    assert [state.up for state in states] == [True, False, True]
    n_fixes, n_injections, n_attitudes = (
        sum(isinstance(thing, kind) for entry in entries for thing in (entry.event, entry.command))
        for kind in (Fix, Injection, Attitude)
    )
    assert n_fixes >= 2  # one of each worker
    assert n_injections >= 10  # so many were waited for
    comparison = compare_with_recording(whole)
    assert (comparison.first_difference, comparison.n_recorded) == (None, comparison.n_replayed)
    assert len(read_header(whole).map_manifest_sha256) == 64
    assert sum(1 for _ in read_frames(whole)) >= 2
    assert sum(len(data) for _, data in read_mavlink(whole, outgoing=False)) > n_attitudes * 36
    assert sum(len(data) for _, data in read_mavlink(whole, outgoing=True)) > n_injections * 100
    assert compare_with_recording(killed).first_difference is None
