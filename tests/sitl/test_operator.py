"""A ground station says where the vehicle is; the real autopilots pass the command on to the daemon, and its answer back."""

from __future__ import annotations

import asyncio
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

from tests.sitl.conftest import program_or_skip
from visloc_companion.adapters.mavlink.operator_call import Caller, say_here
from visloc_companion.adapters.mavlink.pymavlink_link import PymavlinkLink, open_own_channel
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.sim.real.apart import make_pilot
from visloc_companion.sim.real.network import enter_own_network
from visloc_companion.sim.real.pilot import SIMULATOR_PORT
from visloc_companion.sim.real.programs import Simulator, running
from visloc_companion.types import GeoPoint, Notice, OperatorFix, Severity

PLACE, SIGMA_M = GeoPoint(47.3981, 8.5461, 0.0), 40.0
BETWEEN_S = 12.0
"""Eight tries: the autopilot boots and finds its origin meanwhile."""
ANSWER = "visloc: position taken, looking there"


def tell(simulator: Simulator, program: Path, folder: Path) -> tuple[list[OperatorFix], str]:
    """In a process and a network of its own: the program opens ports on all interfaces."""
    enter_own_network()
    pilot = make_pilot(simulator)
    command, environment = pilot.command(program, folder, 1.0)
    with running(command, folder, environment):
        return asyncio.run(told(pilot.station_url))


async def told(station_url: str) -> tuple[list[OperatorFix], str]:
    """What the daemon's link made of it, and what the ground station read."""
    link = PymavlinkLink(f"udpin:127.0.0.1:{SIMULATOR_PORT}", SessionSettings(), MonotonicClock())
    heard: list[OperatorFix] = []

    async def read() -> None:
        async for event in link.events():
            if isinstance(event, OperatorFix):
                heard.append(event)
                await link.notify(Notice(Severity.NOTICE, ANSWER, to_operator=True))

    reader = asyncio.create_task(read())
    try:
        said = await say_here(station_url, PLACE, SIGMA_M, Caller(), open_own_channel, BETWEEN_S)
        return heard, said
    finally:
        await link.close()
        await reader


@pytest.mark.sitl
@pytest.mark.timeout(300)
@pytest.mark.parametrize("simulator", [Simulator.ARDUCOPTER, Simulator.PX4])
def test_an_operators_position_goes_through_the_autopilot(simulator: Simulator, tmp_path: Path) -> None:
    program = program_or_skip(simulator)
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        heard, said = pool.submit(tell, simulator, program, tmp_path).result()
    assert said == ANSWER
    assert heard[0].sigma_m == SIGMA_M
    assert (heard[0].place.lat_deg, heard[0].place.lon_deg) == pytest.approx((PLACE.lat_deg, PLACE.lon_deg), abs=1e-7)
