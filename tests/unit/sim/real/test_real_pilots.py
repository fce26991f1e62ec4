"""What the pilots of the real simulators do before they take off, and where their vehicles stand."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import pytest

from visloc_companion.sim.real.apart import make_pilot
from visloc_companion.sim.real.pilot import HOME, Leg, Route
from visloc_companion.sim.real.programs import Simulator
from visloc_companion.sim.real.station import MissionItem, Station
from visloc_companion.types import GeoPoint

ROUTE = Route((Leg(100.0, 0.0),), height_m=60.0, speed_mps=10.0)
ELSEWHERE = GeoPoint(48.0, 10.0, 300.0)
CLIMB_OF_THE_REFERENCE_MPS = 3.0
"""FW_T_CLMB_R_SP as PX4 has it."""


class Willing:
    """A station whose vehicle does as it is told at once; notes what came before it was armed."""

    def __init__(self) -> None:
        self.waited_s, self.items = 0.0, list[MissionItem]()
        self._armed = False

    async def upload(self, items: list[MissionItem]) -> None:
        self.items = items

    async def holds(self, _condition: object, timeout_s: float) -> bool:
        self.waited_s += 0.0 if self._armed else timeout_s
        return False

    async def command(self, number: int, *_: Any, **__: Any) -> None:
        self._armed |= number == 400

    async def until(self, *_: object) -> None:
        return


async def taken_off(simulator: Simulator, home: GeoPoint = HOME) -> Willing:
    station = Willing()
    await make_pilot(simulator, home=home).take_off(cast(Station, station), ROUTE)
    return station


async def test_px4s_plane_stands_until_the_altitude_that_it_follows_is_at_home() -> None:
    """Or it sinks on its first leg: that altitude begins at 0 m above the sea."""
    for home in (HOME, ELSEWHERE):
        waited_s = (await taken_off(Simulator.PX4_PLANE, home)).waited_s
        assert waited_s > home.h_amsl_m / CLIMB_OF_THE_REFERENCE_MPS


async def test_a_copter_waits_for_nothing() -> None:
    assert (await taken_off(Simulator.PX4)).waited_s == 0


@pytest.mark.parametrize("simulator", list(Simulator))
async def test_the_mission_is_flown_about_home(simulator: Simulator) -> None:
    items = (await taken_off(simulator, ELSEWHERE)).items
    places = [item for item in items if item.command == 16]
    assert all(abs(item.lat_deg - ELSEWHERE.lat_deg) < 0.01 and abs(item.lon_deg - ELSEWHERE.lon_deg) < 0.01 for item in places)


@pytest.mark.parametrize("simulator", list(Simulator))
def test_the_vehicle_is_put_at_home(simulator: Simulator, tmp_path: Path) -> None:
    command, environment = make_pilot(simulator, home=ELSEWHERE).command(Path("/build/bin/one"), tmp_path, 1.0)
    if simulator.is_px4:
        assert (environment["PX4_PARAM_SIH_LOC_LAT0"], environment["PX4_PARAM_SIH_LOC_H0"]) == ("48.0", "300.0")
    else:
        assert command[command.index("--home") + 1] == "48.0,10.0,300.0,0"
