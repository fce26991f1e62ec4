"""The ground station of the real flights, against a scripted autopilot on the loopback."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

import pytest

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.framing import Framer
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.errors import LinkError
from visloc_companion.sim.real.station import MissionItem, Station

SPEED = 50.0


class Scripted:
    """Answers like an autopilot: the first arming is refused, an unknown parameter is passed over, a mission is fetched whole."""

    def __init__(self) -> None:
        self.armings, self.mission, self.rates = 0, list[Any](), dict[int, float]()
        self.commands = list[int]()
        self._framer, self._mav = Framer(), mav.MAVLink(None, srcSystem=7, srcComponent=1)
        self._writer: asyncio.StreamWriter | None = None
        self._wanted = 0

    async def run(self, port: int) -> None:
        reader, self._writer = await asyncio.open_connection("127.0.0.1", port)
        self.say(mav.MAVLink_heartbeat_message(mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3))
        try:
            while data := await reader.read(4096):
                for message in self._framer.feed(data):
                    self.answer(message)
        finally:
            self._writer.close()

    def say(self, message: Any) -> None:
        assert self._writer is not None
        self._writer.write(message.pack(self._mav))

    def answer(self, message: Any) -> None:
        kind = message.get_type()
        if kind == "COMMAND_LONG":
            self.commands.append(message.command)
            self.armings += message.command == mav.MAV_CMD_COMPONENT_ARM_DISARM
            refused = message.command == mav.MAV_CMD_COMPONENT_ARM_DISARM and self.armings == 1
            if message.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL:
                self.rates[round(message.param1)] = 1e6 / message.param2
                self.say(mav.MAVLink_attitude_message(1000, 0, 0, 0, 0, 0, 0))
            self.say(mav.MAVLink_command_ack_message(message.command, 4 if refused else 0))
        elif kind == "PARAM_SET" and message.param_id.rstrip("\0") == "SIM_WIND_SPD":
            self.say(mav.MAVLink_param_value_message(b"SIM_WIND_SPD", message.param_value, 9, 1, 0))
        elif kind == "MISSION_COUNT":
            self._wanted = message.count
            self.say(mav.MAVLink_mission_request_int_message(255, 190, 0))
        elif kind == "MISSION_ITEM_INT":
            self.mission.append(message)
            done = len(self.mission) == self._wanted
            answer = mav.MAVLink_mission_ack_message(255, 190, 0) if done else None
            self.say(answer or mav.MAVLink_mission_request_int_message(255, 190, len(self.mission)))


@pytest.fixture
async def met(unused_tcp_port: int) -> AsyncIterator[tuple[Station, Scripted]]:
    """A station and the autopilot that has connected to it."""
    station, autopilot = Station(f"tcpin:127.0.0.1:{unused_tcp_port}", MonotonicClock(SPEED), lambda _: None), Scripted()
    await station.open()
    talking = asyncio.create_task(autopilot.run(unused_tcp_port))
    await station.until("heartbeat", lambda: "HEARTBEAT" in station.last, 100.0)
    yield station, autopilot
    station.close()
    talking.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await talking


async def test_a_command_is_repeated_until_it_is_accepted(met: tuple[Station, Scripted]) -> None:
    station, autopilot = met
    await station.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    assert autopilot.armings == 2
    assert station.system_id == 7


async def test_a_stream_is_asked_for_until_it_comes(met: tuple[Station, Scripted]) -> None:
    station, autopilot = met
    await station.stream({mav.MAVLINK_MSG_ID_ATTITUDE: 20.0})
    assert autopilot.rates == {mav.MAVLINK_MSG_ID_ATTITUDE: pytest.approx(20.0)}


async def test_a_stream_that_never_comes_is_named(met: tuple[Station, Scripted]) -> None:
    station, _ = met
    with pytest.raises(LinkError, match="SIM_STATE did not come"):
        await station.stream({mav.MAVLINK_MSG_ID_SIM_STATE: 20.0})


async def test_a_parameter_is_confirmed_and_an_unknown_one_is_an_error(met: tuple[Station, Scripted]) -> None:
    station, _ = met
    await station.set_parameter("SIM_WIND_SPD", 4.5)
    with pytest.raises(LinkError, match="SIM_NOTHING did not become 1"):
        await station.set_parameter("SIM_NOTHING", 1.0)


async def test_what_the_autopilot_passes_on_is_kept_apart_from_its_own(met: tuple[Station, Scripted]) -> None:
    station, autopilot = met
    autopilot.say(mav.MAVLink_statustext_message(2, b"EKF3 IMU0 is using GPS"))
    await station.until("own text", lambda: bool(station.texts), 100.0)
    autopilot._mav.srcComponent = 197
    autopilot.say(mav.MAVLink_statustext_message(2, b"visloc: GNSS lost, no fix"))
    await station.until("text passed on", lambda: bool(station.passed_on), 100.0)
    assert [text for _, text in station.texts] == ["EKF3 IMU0 is using GPS"]
    assert [text for _, text in station.passed_on] == ["visloc: GNSS lost, no fix"]


async def test_commands_at_one_time_are_each_answered(met: tuple[Station, Scripted]) -> None:
    station, autopilot = met
    await asyncio.gather(station.command(mav.MAV_CMD_DO_SET_MODE, 1.0), station.command(mav.MAV_CMD_SET_EKF_SOURCE_SET, 2.0))
    assert autopilot.commands == [mav.MAV_CMD_DO_SET_MODE, mav.MAV_CMD_SET_EKF_SOURCE_SET]


async def test_a_mission_arrives_item_by_item(met: tuple[Station, Scripted]) -> None:
    station, autopilot = met
    items = [MissionItem(16, (float(n), 0.0, 0.0, 0.0), 47.0 + n, 8.0, 60.0) for n in range(3)]
    await station.upload(items)
    assert [(item.seq, item.x, item.z, item.param1) for item in autopilot.mission] == [
        (n, 470_000_000 + n * 10_000_000, 60.0, float(n)) for n in range(3)
    ]
