"""The real worker: a pack on disk, the real localiser, frames through shared memory."""

from __future__ import annotations

import asyncio
import math
import os
import shutil
import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.unit.landing_gear import legs, with_gear
from visloc_companion.adapters.camera.calibration import camera_model
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.app.slots import SharedFrameSlots
from visloc_companion.app.worker import WorkerSupervisor
from visloc_companion.app.worker_process import open_localiser
from visloc_companion.config import Config, parse_config
from visloc_companion.errors import ConfigError, MapError
from visloc_companion.geo.wgs84 import distance_m
from visloc_companion.maps.pack import PackMap
from visloc_companion.types import Fix, FrameRef, GeoPoint, Image, LocaliseRequest, NoFix, PosePrior, WorkerState

GSD_M, HEIGHT_M = 0.5, 80.0
EAST_M, NORTH_M = 500_000.0, 5_205_000.0


@pytest.fixture
def pack(small_world: Any) -> Path:
    return small_world.pack


def configuration(pack: Path) -> Config:
    """A camera whose pixels are as large on the ground as the map's, from HEIGHT_M."""
    focal = HEIGHT_M / GSD_M
    camera = {"url": "x:y", "width_px": 240, "height_px": 200, "fx_px": focal, "fy_px": focal, "cx_px": 119.5, "cy_px": 99.5}
    own = {"localiser": {"method": "gradient"}, "navigator": {"map_sigma_m": 0.1}}
    return parse_config({"camera": camera, "map": {"pack": str(pack)}, **own})


def nadir(pack: Path, config: Config) -> tuple[Image, GeoPoint]:
    """What the camera sees north-up over the middle of the map, and from where."""
    world = PackMap.open(pack)
    centre = (EAST_M + 140.0, NORTH_M - 160.0)
    seen = world.patch(centre, (config.camera.width_px, config.camera.height_px), GSD_M, 0.0)
    lat, lon = world.to_geo(*centre)
    grey = seen.pixels if seen.pixels.ndim == 2 else seen.pixels[:, :, 0]
    return np.ascontiguousarray(grey), GeoPoint(lat, lon, HEIGHT_M)


@asynccontextmanager
async def worker(config: Config) -> AsyncIterator[tuple[SharedFrameSlots, WorkerSupervisor]]:
    with SharedFrameSlots(camera_model(config.camera)) as slots:
        supervisor = WorkerSupervisor(config, slots, MonotonicClock(), on_notice=lambda _: None)
        try:
            await supervisor.start()
            assert isinstance(await supervisor.events.get(), WorkerState)
            yield slots, supervisor
        finally:
            await supervisor.close()


async def answer(supervisor: WorkerSupervisor) -> Fix | NoFix:
    while not isinstance(event := await asyncio.wait_for(supervisor.events.get(), 60), (Fix, NoFix)):
        pass
    return event


async def test_a_frame_is_localised_before_and_after_the_worker_was_killed(pack: Path) -> None:
    config = configuration(pack)
    pixels, truth = nadir(pack, config)
    north_m = 111_200.0
    seen_from = GeoPoint(truth.lat_deg + 9.0 / north_m, truth.lon_deg - 7.0 / north_m, truth.h_amsl_m + 1.0)
    prior = PosePrior(seen_from, (1.0, 0.0, 0.0, 0.0), ((64.0, 0.0), (0.0, 64.0)), 2.0, math.radians(3), math.radians(1))
    async with worker(config) as (slots, supervisor):
        for n in range(2):
            frame = FrameRef(0, 5, n, slots.write(pixels), config.camera.width_px, config.camera.height_px, 1)
            slots.announce(frame)
            supervisor.submit(LocaliseRequest(n, frame, prior, 1))
            fix = await answer(supervisor)
            assert isinstance(fix, Fix), fix
            assert (fix.request_id, fix.frame_id, fix.method) == (n, n, "gradient")
            assert abs(fix.place.lat_deg - truth.lat_deg) * north_m < 0.7
            assert abs(fix.place.lon_deg - truth.lon_deg) * north_m * math.cos(math.radians(47)) < 0.7
            pid = supervisor.pid
            assert pid is not None
            if n == 0:
                os.kill(pid, signal.SIGKILL)
                states = [await supervisor.events.get(), await supervisor.events.get()]
                assert [isinstance(state, WorkerState) and state.up for state in states] == [False, True]


def damage(pack: Path, target: Path) -> None:
    """A copy with one bit of every raster changed."""
    shutil.copytree(pack, target)
    for file in target.rglob("*"):
        if file.is_file() and file.suffix != ".json":
            data = bytearray(file.read_bytes())
            data[len(data) // 2] ^= 1
            file.write_bytes(data)


async def test_a_damaged_pack_stands_against_the_start(pack: Path, tmp_path: Path) -> None:
    damaged = tmp_path / "pack"
    damage(pack, damaged)
    with pytest.raises(MapError, match="remedy"):
        async with worker(configuration(damaged)):
            pass


async def test_a_pack_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="remedy"):
        async with worker(configuration(tmp_path / "none")):
            pass


async def test_a_worker_does_not_look_at_what_the_mask_names(pack: Path, tmp_path: Path) -> None:
    """The mask is named by the configuration alone: the process that is spawned reads it."""
    bare = configuration(pack)
    pixels, truth = nadir(pack, bare)
    size = bare.camera.width_px, bare.camera.height_px
    cv2.imwrite(str(tmp_path / "mask.png"), np.where(legs(*size), 0, 255).astype(np.uint8))
    camera = bare.camera.model_copy(update={"mask": str(tmp_path / "mask.png")})
    config = bare.model_copy(update={"camera": camera})
    prior = PosePrior(truth, (1.0, 0.0, 0.0, 0.0), ((64.0, 0.0), (0.0, 64.0)), 2.0, math.radians(3), math.radians(1))
    async with worker(config) as (slots, supervisor):
        frame = FrameRef(0, 5, 0, slots.write(with_gear(pixels)), *size, 1)
        slots.announce(frame)
        request = LocaliseRequest(0, frame, prior, 1)
        supervisor.submit(request)
        told = await answer(supervisor)
    other_gear, untold = (open_localiser(c)(request, with_gear(pixels, seed=6)) for c in (config, bare))
    assert isinstance(told, Fix)
    assert isinstance(other_gear, Fix)
    assert distance_m(told.place, truth) < 0.7
    assert (told.place, told.cov_ne_m2) == (other_gear.place, other_gear.cov_ne_m2)
    assert not isinstance(untold, Fix) or untold.place != told.place


async def test_a_mask_that_is_not_there_stands_against_the_start(pack: Path, tmp_path: Path) -> None:
    config = configuration(pack)
    gone = config.model_copy(update={"camera": config.camera.model_copy(update={"mask": str(tmp_path / "mask.png")})})
    with SharedFrameSlots(camera_model(config.camera)) as slots:
        supervisor = WorkerSupervisor(gone, slots, MonotonicClock(), on_notice=lambda _: None)
        with pytest.raises(ConfigError, match=r"camera.mask = .*mask.png: cannot be read: No such file"):
            await supervisor.start()
