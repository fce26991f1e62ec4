"""First contact with the real autopilots' programs: kind, version and the asked streams arrive over our link.

The programs open ports on all interfaces, so run this in a network namespace of its own (docs/simulation.md).
"""

from __future__ import annotations

import asyncio
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from visloc_companion.adapters.mavlink.pymavlink_link import PymavlinkLink
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.types import Attitude, AutopilotKind, LinkChanged, RequestMessage

ATTITUDE_ID = 30
BOOT_S = 60.0
ARDUCOPTER = (
    "--model quad --home 47.3977,8.5456,488,0 --speedup 1 --wipe -I0 "
    "--serial0 udpclient:127.0.0.1:14550 --serial1 none --serial2 none --rc-in-port 15501"
)


def program(variable: str, name: str, package: str) -> Path:
    found = os.environ.get(variable) or shutil.which(name)
    if not found:
        pytest.skip(f"{variable} is not set and no {name} on PATH; install {package}")
    return Path(found)


@contextmanager
def running(command: list[str], folder: Path, extra: dict[str, str]) -> Iterator[None]:
    with (folder / "autopilot.log").open("wb") as log:
        process = subprocess.Popen(
            command, cwd=folder, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env={**os.environ, **extra}
        )
        try:
            yield
        finally:
            process.kill()
            process.wait()


async def first_contact(url: str) -> tuple[LinkChanged, bool, int]:
    """What the autopilot is, whether ATTITUDE arrives at the asked rate, and how many came."""
    link = PymavlinkLink(url, SessionSettings(), MonotonicClock())
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
        await reader


@pytest.mark.sitl
async def test_arducopter_is_known_and_streams(tmp_path: Path) -> None:
    binary = program("VISLOC_ARDUCOPTER", "arducopter", "ArduPilot's SITL")
    with running([str(binary), *ARDUCOPTER.split()], tmp_path, {}):
        what, arrived, attitudes = await first_contact("udpin:127.0.0.1:14550")
    assert what.autopilot is AutopilotKind.ARDUPILOT
    assert arrived
    assert attitudes > 20


@pytest.mark.sitl
async def test_px4_is_known_and_streams(tmp_path: Path) -> None:
    binary = program("VISLOC_PX4", "px4", "PX4's SITL (px4_sitl)")
    model = {"PX4_SIM_MODEL": "sihsim_quadx", "PX4_SIMULATOR": "sihsim"}
    command = [str(binary), "-d", "-i", "0", "-w", str(tmp_path), str(binary.parents[1] / "etc")]
    with running(command, tmp_path, model):
        what, arrived, attitudes = await first_contact("udpin:127.0.0.1:14540")
    assert what.autopilot is AutopilotKind.PX4
    assert arrived
    assert attitudes > 20
