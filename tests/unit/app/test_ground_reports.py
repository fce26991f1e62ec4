"""What the daemon tells ground stations."""

import asyncio
import math
from pathlib import Path

import pytest

from visloc_companion.app.clock import MonotonicClock
from visloc_companion.app.ground_reports import Condition, GroundReports, named
from visloc_companion.app.health import Sensor, sensor_health
from visloc_companion.config import Config, parse_config
from visloc_companion.types import GeoPoint, Mode, Report, Status, Verdict

PLACE = GeoPoint(47.0, 8.0, 500.0)


def status(mode: Mode = Mode.AIDING, verdict: Verdict = Verdict.DENIED, **changes: object) -> Status:
    known = {"place": PLACE, "protection_level_m": 14.5, "age_of_fix_s": 0.4, "available": True} | changes
    place, level_m, age_s = known.pop("place"), known.pop("protection_level_m"), known.pop("age_of_fix_s")
    cov = ((4.0, 0.0), (0.0, 9.0))
    return Status(1, mode, verdict, (), place, (0.0, 0.0, 0.0), cov, 1.0, level_m, age_s, True, 0, **known)  # type: ignore[arg-type]


def test_the_names_fit_and_say_what_they_hold() -> None:
    values = dict(named(status(vertical_protection_level_m=21.0)))
    assert all(len(name) <= 10 for name in values)
    assert values == {"VL_MODE": 2, "VL_VERDICT": 2, "VL_PL": 14.5, "VL_VPL": 21.0, "VL_SIGMA": 3.0, "VL_FIXAGE": 0.4}


def test_what_is_not_known_is_nan() -> None:
    values = dict(named(status(Mode.WAITING, place=None, protection_level_m=None, age_of_fix_s=None)))
    assert [name for name, value in values.items() if math.isnan(value)] == ["VL_PL", "VL_VPL", "VL_SIGMA", "VL_FIXAGE"]


@pytest.mark.parametrize(
    ("seen", "healthy"),
    [
        (status(), Sensor.VISION_POSITION),
        (status(Mode.SHADOW, Verdict.OK), Sensor.VISION_POSITION | Sensor.GNSS),
        (status(Mode.DEAD_RECKONING), Sensor(0)),
        (status(Mode.LOST), Sensor(0)),
        (status(available=False), Sensor(0)),
        (status(Mode.SHADOW, Verdict.OK, age_of_fix_s=None), Sensor.GNSS),
    ],
)
def test_health_in_the_bits_of_sys_status(seen: Status, healthy: Sensor) -> None:
    assert sensor_health(seen, recording=False) == healthy
    assert sensor_health(seen, recording=True) == healthy | Sensor.LOGGING


def test_what_is_critical() -> None:
    assert not Condition(None, faulty=False, recording=True).critical
    assert not Condition(status(), faulty=False, recording=False).critical
    assert Condition(status(alert=True), faulty=False, recording=True).critical
    assert Condition(None, faulty=True, recording=True).critical


async def reports_of(config: Config, condition: Condition, wanted: int) -> list[Report]:
    sent: list[Report] = []
    enough = asyncio.Event()

    async def send(report: Report) -> None:
        sent.append(report)
        if len(sent) >= wanted:
            enough.set()

    serving = asyncio.create_task(GroundReports(config, MonotonicClock(50.0), lambda: condition, send).serve())
    await asyncio.wait_for(enough.wait(), 20.0)
    serving.cancel()
    await asyncio.gather(serving, return_exceptions=True)
    return sent


async def test_values_and_load_are_told(tmp_path: Path) -> None:
    config = parse_config({"journal": {"folder": str(tmp_path)}, "link": {"telemetry_rate_hz": 2.0}})
    sent = await reports_of(config, Condition(status(), faulty=True, recording=True), 8)
    values = [dict(report.values) for report in sent if report.values]
    assert values[0]["VL_HEALTH"] == Sensor.VISION_POSITION | Sensor.LOGGING
    assert any(report.load is not None for report in sent)
    assert all(report.critical for report in sent)


async def test_both_can_be_switched_off_and_the_state_is_still_told() -> None:
    config = parse_config({"link": {"telemetry_rate_hz": 0, "computer_status": False}})
    sent = await reports_of(config, Condition(status(), faulty=True, recording=False), 3)
    assert {(report.values, report.load, report.critical) for report in sent} == {((), None, True)}


async def test_the_computer_is_looked_at_for_the_status_socket_whatever_the_ground_station_is_told() -> None:
    config = parse_config({"link": {"telemetry_rate_hz": 0, "computer_status": False}})
    looked = asyncio.Event()

    async def send(_: Report) -> None:
        looked.set()

    reports = GroundReports(config, MonotonicClock(50.0), lambda: Condition(None, faulty=False, recording=False), send)
    assert reports.load is None
    serving = asyncio.create_task(reports.serve())
    await asyncio.wait_for(looked.wait(), 20.0)
    serving.cancel()
    await asyncio.gather(serving, return_exceptions=True)
    assert reports.load is not None
    assert reports.load.ram_total_bytes
