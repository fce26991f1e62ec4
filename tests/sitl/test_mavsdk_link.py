"""Our link through MAVSDK with the real autopilots: kind, version and the asked stream arrive."""

from __future__ import annotations

import asyncio
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

from visloc_companion.adapters.mavlink.mavsdk_channel import MavsdkOpener
from visloc_companion.adapters.mavlink.pymavlink_link import PymavlinkLink
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.errors import ConfigError
from visloc_companion.sim.real.apart import make_pilot
from visloc_companion.sim.real.network import enter_own_network
from visloc_companion.sim.real.pilot import SIMULATOR_PORT
from visloc_companion.sim.real.programs import Simulator, find_program, running
from visloc_companion.sim.real.station import Station
from visloc_companion.types import Attitude, AutopilotKind, LinkChanged, RequestMessage

ATTITUDE_ID = 30
BOOT_S = 60.0
KINDS = {Simulator.ARDUCOPTER: AutopilotKind.ARDUPILOT, Simulator.PX4: AutopilotKind.PX4}


def meet(simulator: Simulator, program: Path, folder: Path) -> tuple[LinkChanged, bool, int]:
    """In a process and a network of its own: the program opens ports on all interfaces."""
    enter_own_network()
    pilot = make_pilot(simulator)
    command, environment = pilot.command(program, folder, 1.0)
    with running(command, folder, environment):
        return asyncio.run(contact(pilot.station_url))


async def contact(station_url: str) -> tuple[LinkChanged, bool, int]:
    """What the autopilot is, whether ATTITUDE arrives at the asked rate, and how many came."""
    station = Station(station_url, MonotonicClock(), lambda _message: None)
    await station.open()
    opener = MavsdkOpener(0, 197)
    link = PymavlinkLink(f"udpin:127.0.0.1:{SIMULATOR_PORT}", SessionSettings(), MonotonicClock(), open_channel=opener)
    known: asyncio.Future[LinkChanged] = asyncio.get_running_loop().create_future()
    attitudes = 0

    async def read() -> None:
        nonlocal attitudes
        async for event in link.events():
            attitudes += isinstance(event, Attitude)
            if isinstance(event, LinkChanged) and event.up and event.version and not known.done():
                known.set_result(event)

    reader = asyncio.create_task(read())
    try:
        what = await asyncio.wait_for(asyncio.shield(known), BOOT_S)
        arrived = await asyncio.wait_for(link.request(RequestMessage(ATTITUDE_ID, 20.0)), BOOT_S)
        return what, arrived, attitudes
    finally:
        await link.close()
        station.close()
        await reader


@pytest.mark.sitl
@pytest.mark.timeout(300)
@pytest.mark.parametrize("simulator", KINDS)
def test_an_autopilot_is_known_and_streams_through_mavsdk(simulator: Simulator, tmp_path: Path) -> None:
    pytest.importorskip("mavsdk", reason="MAVSDK is missing: pip install 'visloc-companion[mavsdk]'")
    try:
        program = find_program(simulator)
    except ConfigError as why:
        pytest.skip(str(why))
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        what, arrived, attitudes = pool.submit(meet, simulator, program, tmp_path).result()
    assert what.autopilot is KINDS[simulator]
    assert arrived
    assert attitudes > 20
