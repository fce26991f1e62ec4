"""The operator at the ground station, who switches the source as the daemon's texts ask."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.sim.real.apart import make_pilot
from visloc_companion.sim.real.clock import EPOCH_NS, SlavedClock
from visloc_companion.sim.real.lives import daemon_config
from visloc_companion.sim.real.operator import OperatorsHand, asked_for
from visloc_companion.sim.real.programs import Simulator
from visloc_companion.sim.real.record import RealLog
from visloc_companion.sim.real.recorder import Recorder
from visloc_companion.sim.real.scenario import Operator
from visloc_companion.sim.real.scenarios import real_scenario
from visloc_companion.sim.real.station import Station
from visloc_companion.types import EkfSource

VISION, GNSS = (f"visloc: set EKF position source to {name}" for name in ("VISION", "GNSS"))


class Obeyed(Station):
    """Notes what the autopilot is told."""

    def __init__(self, clock: SlavedClock) -> None:
        super().__init__("tcpin:127.0.0.1:1", clock, lambda _: None)
        self.told = list[tuple[float, int, float]]()
        self._time = clock

    async def command(self, number: int, *params: float, tries: int = 1) -> None:
        self.told.append(((self._time.now_ns() - EPOCH_NS) * 1e-9, number, params[0]))

    async def set_integer(self, name: str, value: int) -> None:
        assert name == "EKF2_GPS_CTRL"
        self.told.append(((self._time.now_ns() - EPOCH_NS) * 1e-9, 0, value))


@pytest.mark.parametrize(
    ("text", "source"), [(VISION, EkfSource.VISION), (GNSS, EkfSource.GNSS), ("visloc: EKF source vision refused", None)]
)
def test_he_understands_what_he_is_asked_for(text: str, source: EkfSource | None) -> None:
    assert asked_for(text) is source


async def switched(simulator: Simulator, texts: dict[int, str]) -> tuple[Obeyed, Recorder]:
    """Texts that come at seconds of the autopilot's clock, and 40 s of it."""
    clock = SlavedClock()
    pilot = make_pilot(simulator)
    station, recorder = Obeyed(clock), Recorder(pilot, clock, RealLog())
    serving = asyncio.create_task(OperatorsHand(Operator(2.0, 15.0), pilot, station, recorder).serve())
    for t_s in range(40):
        clock.hear(t_s * 1_000_000_000)
        if t_s in texts:
            station.passed_on.append((clock.now_ns(), texts[t_s]))
        await asyncio.sleep(0.05)
    serving.cancel()
    return station, recorder


@pytest.mark.parametrize("simulator", [Simulator.ARDUCOPTER, Simulator.PX4])
async def test_he_hurries_to_vision_and_takes_his_time_back(simulator: Simulator) -> None:
    station, recorder = await switched(simulator, {1: VISION, 10: GNSS})
    values = (0, 7) if simulator.is_px4 else (2, 1)
    number = 0 if simulator.is_px4 else mav.MAV_CMD_SET_EKF_SOURCE_SET
    assert station.told == [(3.0, number, values[0]), (25.0, number, values[1])]
    assert [name for _, name in recorder.log.marks] == ["asked for vision", "source vision", "asked for gnss", "source gnss"]


async def test_what_he_is_asked_last_counts() -> None:
    station, _ = await switched(Simulator.ARDUCOPTER, {1: GNSS, 10: VISION})
    assert [value for *_, value in station.told] == [2]


def test_the_daemon_may_not_switch_then_and_leaves_word_to_the_next_one(tmp_path: Path) -> None:
    simulator = Simulator.ARDUCOPTER
    made: Any = {
        name: daemon_config(make_pilot(simulator), real_scenario(name, simulator), tmp_path)
        for name in ("restarts", "restart_after_return")
    }
    assert {name: config.injection.switch_source for name, config in made.items()} == {
        "restarts": True,
        "restart_after_return": False,
    }
    assert all(Path(config.status.socket).parent == tmp_path for config in made.values())
