"""Facts with which every rule is green, for both autopilots; a built-in autopilot on a socket of this machine."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from tests.unit.doctor.parameter_files import read_parameters
from visloc_companion.config import parse_config
from visloc_companion.doctor.facts import CameraFacts, Facts, LinkFacts, MapFacts, ModelFacts, SystemFacts
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.autopilots.autopilot_parameters import PREPARED, TOLD
from visloc_companion.types import AutopilotKind, GeoPoint

ROOT = Path(__file__).resolve().parents[3]
HOME = GeoPoint(47.3977, 8.5456, 488.0)
FILES = {AutopilotKind.ARDUPILOT: "ardupilot.parm", AutopilotKind.PX4: "px4.parm"}
MORE = {
    AutopilotKind.ARDUPILOT: {"SERIAL1_PROTOCOL": 2.0, "SERIAL1_BAUD": 921.0},
    AutopilotKind.PX4: {
        "MAV_1_CONFIG": 102.0,
        "SER_TEL2_BAUD": 921600.0,
        "UXRCE_DDS_CFG": 0.0,
        "EKF2_SENS_EN": 8191.0,
        "SENS_BARO_QNH": 1021.0,
    },
}
RATES = {"ATTITUDE": 50.0, "SCALED_IMU": 50.0, "GLOBAL_POSITION_INT": 10.0, "LOCAL_POSITION_NED": 10.0, "GPS_RAW_INT": 5.0}
CAMERA = {
    "url": "device:/dev/video0",
    "width_px": 640,
    "height_px": 480,
    "fx_px": 554.0,
    "fy_px": 554.0,
    "cx_px": 319.5,
    "cy_px": 239.5,
    "distortion": [0.1, 0, 0, 0, 0],
    "latency_s": 0.05,
    "readout_ms": 20.0,
}
STATUS = {AutopilotKind.ARDUPILOT: "EKF_STATUS_REPORT", AutopilotKind.PX4: "ESTIMATOR_STATUS"}


def recommended(kind: AutopilotKind) -> dict[str, float]:
    """The parameter file that users are told to load, as a vehicle takes it that does not know the names of later versions."""
    file = read_parameters(ROOT / "docs" / "parameters" / FILES[kind])
    return {name: value for name, value in file.items() if name in PREPARED[kind]}


def good_facts(kind: AutopilotKind) -> Facts:
    """An installation with which nothing is wrong."""
    parameters = PREPARED[kind] | TOLD[kind] | recommended(kind) | MORE[kind]
    config = parse_config(
        {
            "link": {"url": "serial:/dev/ttyAMA0:921600"},
            "camera": CAMERA,
            "map": {"pack": "pack"},
            "journal": {"folder": "journals"},
            "injection": {"switch_source": True},
        }
    )
    rates = RATES | {STATUS[kind]: 2.0}
    link = LinkFacts(
        url="serial:/dev/ttyAMA0:921600",
        system_id=1,
        vehicle="copter",
        armed=False,
        mavlink_version=2,
        garbage_share=0.0,
        parameters_expected=len(parameters),
        asked_hz=rates,
        rates_hz=rates,
        refused=frozenset(),
        rtt_ms=(2.0, 2.5, 3.0, 2.2, 2.8, 2.4),
        timesync_requests_hz=10.0,
        drift_ppm=12.0,
        drift_sigma_ppm=5.0,
        origin=HOME,
        home=HOME,
        mission=(HOME,),
        position=HOME,
        claims_position=True,
        position_ratio=0.2,
        fix_type=3,
        n_satellites=14,
        gnss_h_amsl_m=488.0,
        barometer_h_amsl_m=483.0,
    )
    return Facts(
        autopilot=kind,
        version="4.7.0" if kind is AutopilotKind.ARDUPILOT else "1.17.0",
        parameters=parameters,
        config=config,
        link=link,
        camera=CameraFacts(rate_hz=20.0, n_frames=60, dark=0.01, bright=0.02, still=0.0),
        map=MapFacts("", datetime.now(tz=UTC).date().isoformat(), 0.3, True, 1.0, 400.0, 300.0, 0.5, "", signed_by="ab" * 32),
        model=ModelFacts(True, "", "network on cpu", "cpu"),
        system=SystemFacts(4, 0.5, 2000.0, 0.0, 50.0, "schedutil", True, 64, 10_000.0, "", "", False),
    )


class _Peer(asyncio.DatagramProtocol):
    def __init__(self, pilot: BuiltInAutopilot) -> None:
        self.pilot, self.transport = pilot, None

    def connection_made(self, transport: Any) -> None:
        self.transport = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self.pilot.receive(data)
        self.flush()

    def error_received(self, exc: Exception) -> None:
        """Nobody listens yet."""

    def flush(self) -> None:
        data = self.pilot.outgoing()
        for start in range(0, len(data), 1200):
            self.transport.sendto(data[start : start + 1200])


@asynccontextmanager
async def _served(pilot: BuiltInAutopilot, port: int) -> AsyncIterator[None]:
    loop = asyncio.get_running_loop()
    transport, peer = await loop.create_datagram_endpoint(lambda: _Peer(pilot), remote_addr=("127.0.0.1", port))

    async def pump() -> None:
        last = loop.time()
        while True:
            now = loop.time()
            pilot.step(min(now - last, 0.2))
            last = now
            peer.flush()
            await asyncio.sleep(0.02)

    task = loop.create_task(pump())
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        transport.abort()
        await asyncio.sleep(0)


@pytest.fixture
def served() -> Callable[..., Any]:
    """`async with served(pilot, port)`: the autopilot speaks to a port of this machine in real time."""
    return _served


@pytest.fixture
def good() -> Callable[[AutopilotKind], Facts]:
    """`good(kind)`: see good_facts."""
    return good_facts
