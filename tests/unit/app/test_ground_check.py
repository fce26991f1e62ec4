"""What the map says of the place where GNSS puts a vehicle on the ground."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from visloc_companion.app import ground_check
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.app.ground_check import Ground, GroundCheck, look, open_pack
from visloc_companion.config import Config, parse_config
from visloc_companion.errors import MapError
from visloc_companion.types import Event, GeoPoint, Gnss, LinkChanged, MapAtGnss

HERE = GeoPoint(47.0, 8.0, 431.0)
GNSS = Gnss(0, 0, 3, 12, HERE, 1.0, 1.0, None)


class Flat:
    """A map of one degree about 47 N 8 E, at 430 m."""

    def covers(self, lat_deg: float, lon_deg: float, margin_m: float = 0.0) -> bool:
        return abs(lat_deg - 47) < 0.5 and abs(lon_deg - 8) < 0.5

    def to_map(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        return lon_deg, lat_deg

    def height_amsl_m(self, easting_m: float, northing_m: float) -> float:
        return 430.0 if northing_m < 47.2 else float("nan")


FLAT: Any = Flat()


def test_a_place_on_off_and_above_the_map() -> None:
    assert look(Ground(FLAT, True), HERE, 5) == MapAtGnss(5, HERE, True, 430.0)
    assert look(Ground(FLAT, False), HERE, 5).surface_amsl_m is None  # a plane says nothing
    hole, away = GeoPoint(47.3, 8.0, 0.0), GeoPoint(48.0, 8.0, 0.0)
    assert look(Ground(FLAT, True), hole, 5) == MapAtGnss(5, hole, True, None)
    assert look(Ground(FLAT, True), away, 5) == MapAtGnss(5, away, False, None)


def test_a_pack_that_is_none_is_an_error_of_the_map(tmp_path: Any) -> None:
    with pytest.raises(MapError):
        open_pack(parse_config({"map": {"pack": str(tmp_path)}}))


async def served(events: list[Event], opened: Any, monkeypatch: pytest.MonkeyPatch) -> list[Event]:
    monkeypatch.setattr(ground_check, "PERIOD_S", 0.01)
    told: list[Event] = []
    check = GroundCheck(Config(), MonotonicClock(), told.append, opened)
    for event in events:
        check.heard(event)
    try:
        await asyncio.wait_for(check.serve(), 0.3)
    except TimeoutError:
        return told
    return [*told, LinkChanged(0, up=False)]


DISARMED = LinkChanged(0, up=True, armed=False)


async def test_asked_on_the_ground_only(monkeypatch: pytest.MonkeyPatch) -> None:
    told = await served([DISARMED, GNSS], lambda _: Ground(FLAT, True), monkeypatch)
    assert told
    assert all(isinstance(t, MapAtGnss) and t.surface_amsl_m == 430.0 for t in told)
    assert await served([GNSS], lambda _: Ground(FLAT, True), monkeypatch) == []
    armed = LinkChanged(0, up=True, armed=True)
    assert await served([DISARMED, GNSS, armed], lambda _: Ground(FLAT, True), monkeypatch) == []


async def test_not_without_a_fix(monkeypatch: pytest.MonkeyPatch) -> None:
    lost = Gnss(0, 0, 1, 3, HERE, None, None, None)
    assert await served([DISARMED, GNSS, lost], lambda _: Ground(FLAT, True), monkeypatch) == []


async def test_a_map_that_cannot_be_opened_ends_it_quietly(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: Config) -> Ground:
        raise MapError("is damaged", where="pack")

    assert await served([DISARMED, GNSS], broken, monkeypatch) == [LinkChanged(0, up=False)]
