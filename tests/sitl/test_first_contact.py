"""First contact with the real autopilots: kind, version and the asked streams arrive, over our link and through MAVSDK."""

from __future__ import annotations

import asyncio
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

from tests.sitl.conftest import program_or_skip
from visloc_companion.adapters.mavlink.mavsdk_channel import MavsdkOpener
from visloc_companion.adapters.mavlink.pymavlink_link import PymavlinkLink
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.sim.real.apart import make_pilot
from visloc_companion.sim.real.network import enter_own_network
from visloc_companion.sim.real.pilot import SIMULATOR_PORT
from visloc_companion.sim.real.programs import Simulator, running
from visloc_companion.sim.real.station import Station
from visloc_companion.types import Attitude, AutopilotKind, LinkChanged, RequestMessage

ATTITUDE_ID = 30
BOOT_S = 60.0
KINDS = {
    Simulator.ARDUCOPTER: AutopilotKind.ARDUPILOT,
    Simulator.ARDUPLANE: AutopilotKind.ARDUPILOT,
    Simulator.PX4: AutopilotKind.PX4,
}


def meet(simulator: Simulator, program: Path, folder: Path, through_mavsdk: bool) -> tuple[LinkChanged, bool, int]:
    """In a process and a network of its own: the program opens ports on all interfaces."""
    enter_own_network()
    pilot = make_pilot(simulator)
    command, environment = pilot.command(program, folder, 1.0)
    with running(command, folder, environment):
        return asyncio.run(first_contact(pilot.station_url, f"udpin:127.0.0.1:{SIMULATOR_PORT}", through_mavsdk))


async def first_contact(station_url: str, url: str, through_mavsdk: bool) -> tuple[LinkChanged, bool, int]:
    """What the autopilot is, whether ATTITUDE arrives at the asked rate, and how many came.

    ArduPilot does not start before its ground station takes the connection.
    """
    station = Station(station_url, MonotonicClock(), lambda _message: None)
    await station.open()
    opener = MavsdkOpener(0, 197) if through_mavsdk else None
    link = PymavlinkLink(url, SessionSettings(), MonotonicClock(), open_channel=opener)
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
@pytest.mark.parametrize("through_mavsdk", [False, True], ids=["own", "mavsdk"])
@pytest.mark.parametrize("simulator", KINDS)
def test_an_autopilot_is_known_and_streams(simulator: Simulator, through_mavsdk: bool, tmp_path: Path) -> None:
    if through_mavsdk:
        pytest.importorskip("mavsdk", reason="MAVSDK is missing: pip install 'visloc-companion[mavsdk]'")
    program = program_or_skip(simulator)
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        what, arrived, attitudes = pool.submit(meet, simulator, program, tmp_path, through_mavsdk).result()
    assert what.autopilot is KINDS[simulator]
    assert arrived
    assert attitudes > 20
