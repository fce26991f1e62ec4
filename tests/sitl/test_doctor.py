"""The doctor on the real autopilots' programs: all green with the recommended parameters; a wrong one is named and set right."""

from __future__ import annotations

import asyncio
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

from tests.sitl.conftest import program_or_skip
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.config import parse_config
from visloc_companion.doctor.examine import Report, Wishes, examine
from visloc_companion.doctor.report import summary
from visloc_companion.sim.real.apart import make_pilot
from visloc_companion.sim.real.network import enter_own_network
from visloc_companion.sim.real.pilot import SIMULATOR_PORT, Pilot
from visloc_companion.sim.real.programs import Simulator, running
from visloc_companion.sim.real.station import Station
from visloc_companion.types import AutopilotKind

URL = f"udpin:127.0.0.1:{SIMULATOR_PORT}"
CONFIG = parse_config({"link": {"url": URL}, "injection": {"switch_source": True}, "localiser": {"terrain": True}})
JUDGED = ("ap-", "px4-", "firmware-")
OF_THE_LINK = ("link-parameters", "link-mavlink-2", "link-noise", "link-origin", "link-home", "link-gnss", "link-ekf-position")
WRONG = {
    AutopilotKind.ARDUPILOT: ("EK3_SRC2_POSXY", 3, "ap-vision-set-position"),
    AutopilotKind.PX4: ("EKF2_EV_NOISE_MD", 1, "px4-ev-noise-mode"),
}
Rows = list[tuple[str, str, str, str]]


def diagnose(simulator: Simulator, program: Path, folder: Path) -> tuple[str, Rows, Rows, dict[str, float], Rows]:
    """In a process and a network of its own: as recommended; with one parameter wrong; after it was set right."""
    enter_own_network()
    pilot = make_pilot(simulator)
    command, environment = pilot.command(program, folder, 1.0)
    with running(command, folder, environment):
        return asyncio.run(_diagnose(pilot))


async def _diagnose(pilot: Pilot) -> tuple[str, Rows, Rows, dict[str, float], Rows]:
    station = Station(pilot.station_url, MonotonicClock(), lambda _message: None)
    await station.open()
    beat = asyncio.create_task(_beat(station))
    try:
        await pilot.prepare(station)
        await asyncio.sleep(10.0)
        good = await examine(Wishes(URL, CONFIG, seconds=5.0, wait_s=60.0))
        name, value, _ = WRONG[pilot.kind]
        await (station.set_integer(name, value) if pilot.kind is AutopilotKind.PX4 else station.set_parameter(name, value))
        wrong = await examine(Wishes(URL, CONFIG, seconds=2.0, wait_s=60.0, apply=True))
        mended = await examine(Wishes(URL, CONFIG, seconds=2.0, wait_s=60.0))
        return summary(good), _rows(good), _rows(wrong), dict(wrong.applied), _rows(mended)
    finally:
        beat.cancel()
        await asyncio.gather(beat, return_exceptions=True)
        station.close()


async def _beat(station: Station) -> None:
    while True:
        station.heartbeat()
        await asyncio.sleep(1.0)


def _rows(report: Report) -> Rows:
    return [(answer.rule.id, str(answer.level), answer.read, answer.remedy) for answer in report.judged]


def _bad(rows: Rows) -> list[tuple[str, str, str, str]]:
    return [row for row in rows if row[1] in ("red", "amber") and (row[0].startswith(JUDGED) or row[0] in OF_THE_LINK)]


@pytest.mark.sitl
@pytest.mark.timeout(400)
@pytest.mark.parametrize("simulator", list(Simulator))
def test_recommended_parameters_are_green_and_a_wrong_one_is_set_right(simulator: Simulator, tmp_path: Path) -> None:
    program = program_or_skip(simulator)
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        told, good, wrong, applied, mended = pool.submit(diagnose, simulator, program, tmp_path).result()
    print(told, *good, sep="\n")  # noqa: T201
    kind = AutopilotKind.PX4 if simulator.is_px4 else AutopilotKind.ARDUPILOT
    name, _, rule = WRONG[kind]
    assert _bad(good) == []
    assert sum(level == "green" for _, level, _, _ in good) >= 45
    assert [(row[0], row[1]) for row in _bad(wrong)] == [(rule, "red")]
    assert applied == {name: 6.0 if name == "EK3_SRC2_POSXY" else 0.0}
    assert _bad(mended) == []
