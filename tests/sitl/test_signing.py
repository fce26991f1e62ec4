"""Signing with the real ArduCopter: it believes what we sign and we what it signs, and without the key nobody is believed."""

from __future__ import annotations

import asyncio
import multiprocessing
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.sitl.conftest import program_or_skip
from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.pymavlink_link import PymavlinkLink
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.adapters.mavlink.signing import SigningSettings, stamp_at_zero
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.sim.real.apart import make_pilot
from visloc_companion.sim.real.network import enter_own_network
from visloc_companion.sim.real.pilot import SIMULATOR_PORT
from visloc_companion.sim.real.programs import Simulator, running
from visloc_companion.sim.real.station import Station
from visloc_companion.types import LinkChanged, RequestMessage

ATTITUDE_ID = 30
BOOT_S = 60.0
KEY, OTHER_KEY = bytes(range(32)), bytes(range(1, 33))


@dataclass
class Outcome:
    """What one link achieved: whether the autopilot came up, its version, whether a stream was granted, and what was refused."""

    up: bool = False
    version: str = ""
    granted: bool = False
    unbelieved: Counter[str] = field(default_factory=Counter)


def try_all(program: Path, folder: Path) -> dict[str, Outcome]:
    """In a process and a network of its own: the program opens ports on all interfaces."""
    enter_own_network()
    pilot = make_pilot(Simulator.ARDUCOPTER)
    command, environment = pilot.command(program, folder, 1.0)
    with running(command, folder, environment):
        return asyncio.run(converse(pilot.station_url))


async def converse(station_url: str) -> dict[str, Outcome]:
    """Give the autopilot the key over its first link, then talk to it over its second with the key, without, and with another."""
    station = Station(station_url, MonotonicClock(), lambda _message: None)
    await station.open()
    try:
        await station.until("heartbeat", lambda: "HEARTBEAT" in station.last, BOOT_S)
        station.send(mav.MAVLink_setup_signing_message(1, 1, list(KEY), 1))
        return {
            "signed": await contact(KEY, BOOT_S),
            "unsigned": await contact(None, 8.0),
            "another key": await contact(OTHER_KEY, 8.0),
            "signed again": await contact(KEY, BOOT_S),
        }
    finally:
        station.close()


async def contact(key: bytes | None, patience_s: float) -> Outcome:
    """Open a link and ask for what an autopilot grants to whom it believes."""
    clock, outcome = MonotonicClock(), Outcome()
    signing = None if key is None else SigningSettings(key, stamp_at_zero=stamp_at_zero(time.time_ns(), clock.now_ns()))
    link = PymavlinkLink(f"udpin:127.0.0.1:{SIMULATOR_PORT}", SessionSettings(signing=signing), clock)
    known = asyncio.Event()

    async def read() -> None:
        async for event in link.events():
            if isinstance(event, LinkChanged):
                outcome.up, outcome.version = event.up, event.version
                if event.up and event.version:
                    known.set()

    reader = asyncio.create_task(read())
    try:
        async with asyncio.timeout(patience_s):
            await known.wait()
            outcome.granted = await link.request(RequestMessage(ATTITUDE_ID, 20.0))
    except TimeoutError:
        pass
    outcome.unbelieved = Counter({str(reason): n for reason, n in link.session.unbelieved.items()})
    await link.close()
    await reader
    return outcome


@pytest.mark.sitl
@pytest.mark.timeout(300)
def test_arducopter_believes_only_the_holder_of_its_key(tmp_path: Path) -> None:
    program = program_or_skip(Simulator.ARDUCOPTER)
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        outcomes = pool.submit(try_all, program, tmp_path).result()
    signed, again = outcomes["signed"], outcomes["signed again"]
    assert (signed.up, bool(signed.version), signed.granted) == (True, True, True)
    assert (again.up, bool(again.version), again.granted) == (True, True, True)
    assert outcomes["unsigned"].version == "", "it does not answer to unsigned commands"
    assert not outcomes["another key"].up
    assert outcomes["another key"].unbelieved["wrong"] > 0
