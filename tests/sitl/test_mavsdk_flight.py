"""MAVSDK flies the real ArduCopter, as a user's own program would: arm, take off, a mission, landing."""

from __future__ import annotations

import asyncio
import math
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from tests.sitl.conftest import program_or_skip
from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.geo.wgs84 import geo_from_ned, ned_from_geo
from visloc_companion.sim.real.apart import make_pilot
from visloc_companion.sim.real.network import enter_own_network
from visloc_companion.sim.real.pilot import HOME, SIMULATOR_PORT
from visloc_companion.sim.real.programs import Simulator, running
from visloc_companion.sim.real.station import Station
from visloc_companion.types import GeoPoint

SPEED = 4.0
HEIGHT_M = 12.0
LEGS_NE_M = ((40.0, 0.0), (40.0, 30.0))
PATIENCE_S = 90.0


@dataclass
class Flown:
    """Where the vehicle was (north, east, height above home; metres), and whether it stands disarmed at the end."""

    track: list[tuple[float, float, float]] = field(default_factory=list)
    landed: bool = False


def fly(program: Path, folder: Path) -> Flown:
    """In a process and a network of its own: the program opens ports on all interfaces."""
    enter_own_network()
    command, environment = make_pilot(Simulator.ARDUCOPTER).command(program, folder, SPEED)
    with running(command, folder, environment):
        return asyncio.run(guide(make_pilot(Simulator.ARDUCOPTER).station_url))


async def guide(station_url: str) -> Flown:
    """ArduPilot does not start before its first link is taken; MAVSDK has the second to itself."""
    from mavsdk.asyncio.mavsdk import Configuration, Mavsdk
    from mavsdk.component_type import ComponentType

    first_link = Station(station_url, MonotonicClock(), lambda _message: None)
    await first_link.open()
    configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    flown = Flown()
    try:
        async with Mavsdk(configuration) as mavsdk, asyncio.timeout(2 * PATIENCE_S):
            await mavsdk.add_any_connection(f"udpin://127.0.0.1:{SIMULATOR_PORT}")
            system = await mavsdk.first_autopilot(PATIENCE_S)
            assert system is not None
            await mission(system, flown)
    finally:
        first_link.close()
        configuration.destroy()
    return flown


async def mission(system: Any, flown: Flown) -> None:
    """The whole flight."""
    from mavsdk.asyncio.plugins.action.action import ActionAsync
    from mavsdk.asyncio.plugins.mission_raw.mission_raw import MissionRawAsync
    from mavsdk.asyncio.plugins.telemetry.telemetry import TelemetryAsync

    action, raw, telemetry = ActionAsync(system), MissionRawAsync(system), TelemetryAsync(system)
    await telemetry.set_rate_position(10.0)
    watching = asyncio.create_task(watch(telemetry, flown))
    try:
        await until_it_works(lambda: raw.upload_mission(items()))
        await action.set_takeoff_altitude(HEIGHT_M)
        await until_it_works(lambda: lift(action))
        await until(lambda: bool(flown.track) and flown.track[-1][2] > 0.9 * HEIGHT_M)
        await raw.start_mission()
        for north_m, east_m in LEGS_NE_M:
            await until(lambda north_m=north_m, east_m=east_m: near(flown.track[-1], north_m, east_m))
        await action.land()
        async for armed in telemetry.subscribe_armed():
            if not armed:
                flown.landed = True
                break
    finally:
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)


async def lift(action: Any) -> None:
    """Refused while the EKF has no position."""
    await action.arm()
    await action.takeoff()


async def watch(telemetry: Any, flown: Flown) -> None:
    """Note every position."""
    async for seen in telemetry.subscribe_position():
        place = GeoPoint(seen.latitude_deg, seen.longitude_deg, HOME.h_amsl_m)
        north_m, east_m, _ = ned_from_geo(place, HOME)
        flown.track.append((north_m, east_m, seen.relative_altitude_m))


async def until(true: Any) -> None:
    """Wait until something is true."""
    async with asyncio.timeout(PATIENCE_S):
        while not true():  # noqa: ASYNC110 (the truth comes from positions that arrive)
            await asyncio.sleep(0.05)


async def until_it_works(order: Any) -> None:
    """Repeat what the autopilot refuses while it is not ready."""
    from mavsdk import MavsdkError

    async with asyncio.timeout(PATIENCE_S):
        while True:
            try:
                await order()
            except MavsdkError:
                await asyncio.sleep(0.5)
            else:
                return


def near(place: tuple[float, float, float], north_m: float, east_m: float) -> bool:
    return math.hypot(place[0] - north_m, place[1] - east_m) < 5.0


def items() -> list[Any]:
    """Home first, as ArduPilot wants it, then the legs."""
    from mavsdk.plugins.mission_raw import MissionItem

    frame = mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
    places = [geo_from_ned((north_m, east_m, 0.0), HOME) for north_m, east_m in ((0.0, 0.0), *LEGS_NE_M)]
    return [
        MissionItem(n, frame, mav.MAV_CMD_NAV_WAYPOINT, int(n == 0), 1, 0.0, 0.0, 0.0, 0.0,
                    round(place.lat_deg * 1e7), round(place.lon_deg * 1e7), HEIGHT_M, 0)
        for n, place in enumerate(places)
    ]  # fmt: skip


@pytest.mark.sitl
@pytest.mark.timeout(300)
def test_mavsdk_flies_a_mission(tmp_path: Path) -> None:
    pytest.importorskip("mavsdk", reason="MAVSDK is missing: pip install 'visloc-companion[mavsdk]'")
    program = program_or_skip(Simulator.ARDUCOPTER)
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        flown = pool.submit(fly, program, tmp_path).result()
    assert flown.landed
    assert all(any(near(place, *leg) for place in flown.track) for leg in LEGS_NE_M)
    assert max(height_m for _, _, height_m in flown.track) < HEIGHT_M + 5.0
