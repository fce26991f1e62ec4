"""The ground station of a flight against a real simulator: commands with their answers, parameters, mission, and what it hears.

It has a link of its own to the autopilot, as a ground station has; the daemon under test never sees it.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from visloc_companion.adapters.mavlink.channels import Address, Channel, Listener, open_network_channel
from visloc_companion.adapters.mavlink.dialect import AUTOPILOT_COMPONENT, Message, mav
from visloc_companion.adapters.mavlink.encode import float_of_int32, int32_of_float, station_heartbeat
from visloc_companion.adapters.mavlink.endpoint import parse_endpoint
from visloc_companion.adapters.mavlink.framing import Framer
from visloc_companion.errors import LinkError
from visloc_companion.protocols import Clock
from visloc_companion.types import GeoPoint

STATION_SYSTEM, STATION_COMPONENT = 255, 190
_NS_PER_S = 1_000_000_000
_ANSWER_S, _TRIES = 1.5, 5
_SLOWEST, _LOOK_S = 4.0, 0.25
_INTEGERS = (mav.MAV_PARAM_TYPE_INT32, mav.MAV_PARAM_TYPE_INT16, mav.MAV_PARAM_TYPE_INT8)


@dataclass(frozen=True, slots=True)
class MissionItem:
    """One MISSION_ITEM_INT: command, its four parameters, place and height above home (of commands that go somewhere)."""

    command: int
    params: tuple[float, float, float, float]
    lat_deg: float
    lon_deg: float
    height_m: float


class Station:
    """`last` holds the newest message of each type, `texts` every STATUSTEXT with the time at which it came; `passed_on` those of
    others, the daemon's among them, that the autopilot passes on.

    Times are those of the clock, which the autopilot's messages drive: waiting ends when simulated time has passed, or four
    times as much of the machine's. Methods that wait raise LinkError where the autopilot refuses or does not answer.
    """

    def __init__(self, url: str, clock: Clock, on_message: Callable[[Message], None]) -> None:
        self.url, self.last, self.texts = url, dict[str, Message](), list[tuple[int, str]]()
        self.passed_on: list[tuple[int, str]] = []
        self._clock, self._on_message = clock, on_message
        self._one_at_a_time = asyncio.Lock()
        self._framer = Framer()
        self._mav = mav.MAVLink(None, srcSystem=STATION_SYSTEM, srcComponent=STATION_COMPONENT)
        self._channel: Channel | None = None
        self._changed = asyncio.Event()
        self._parameters: dict[str, float] = {}
        self._items: Sequence[MissionItem] = ()

    async def open(self) -> None:
        """Begin to listen. Raises OSError."""
        listener = Listener(self._received, lambda _why: None, lambda: bool(self.last), lambda _who: None)
        self._channel = await open_network_channel(parse_endpoint(self.url), listener)

    def close(self) -> None:
        """Release the socket."""
        if self._channel is not None:
            self._channel.close()

    # --------------------------------------------------------------------------------------------------------- in and out

    def _received(self, data: bytes, source: Address | None) -> None:
        for message in self._framer.feed(data):
            if message.get_srcComponent() != AUTOPILOT_COMPONENT:
                if message.get_type() == "STATUSTEXT":
                    self.passed_on.append((self._clock.now_ns(), message.text.rstrip("\x00")))
                continue
            if self._channel is not None:
                self._channel.speak_to(source)
            self._take(message)
        self._changed.set()

    def _take(self, message: Message) -> None:
        kind = message.get_type()
        self.last[kind] = message
        if kind == "STATUSTEXT":
            self.texts.append((self._clock.now_ns(), message.text.rstrip("\x00")))
        elif kind == "PARAM_VALUE":
            integer = message.param_type in _INTEGERS and self._is_px4
            value = int32_of_float(message.param_value) if integer else message.param_value
            self._parameters[message.param_id.rstrip("\x00")] = float(value)
        elif kind in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
            self._answer_mission(message.seq)
        self._on_message(message)

    @property
    def _is_px4(self) -> bool:
        heartbeat = self.last.get("HEARTBEAT")
        return heartbeat is not None and heartbeat.autopilot == mav.MAV_AUTOPILOT_PX4

    @property
    def system_id(self) -> int:
        """The autopilot's, 1 before it is heard."""
        heartbeat = self.last.get("HEARTBEAT")
        return 1 if heartbeat is None else int(heartbeat.get_srcSystem())

    def send(self, message: Message) -> None:
        """Send a message at once."""
        if self._channel is not None:
            self._channel.write([bytes(message.pack(self._mav))])

    def heartbeat(self) -> None:
        """Say that the ground station is there; due once a second of simulated time."""
        self.send(station_heartbeat())

    # ------------------------------------------------------------------------------------------------------------ waiting

    async def until(self, what: str, condition: Callable[[], bool], timeout_s: float) -> None:
        """Wait until a condition holds, looking at every arrival. Raises LinkError after `timeout_s` of simulated time."""
        if not await self.holds(condition, timeout_s):
            last = "; ".join(text for _, text in self.texts[-4:])
            raise LinkError(f"no {what} within {timeout_s:g} s; the autopilot last said: {last or 'nothing'}", where=self.url)

    async def holds(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait as `until` does; whether the condition came to hold."""
        loop = asyncio.get_running_loop()
        deadline_ns = self._clock.now_ns() + round(timeout_s * _NS_PER_S)
        wall_deadline = loop.time() + _SLOWEST * timeout_s
        while not condition():
            if self._clock.now_ns() > deadline_ns or loop.time() > wall_deadline:
                return False
            self._changed.clear()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._changed.wait(), _LOOK_S)
        return True

    # ----------------------------------------------------------------------------------------------------------- commands

    async def command(self, number: int, *params: float, tries: int = _TRIES) -> None:
        """COMMAND_LONG until it is accepted; one waits for the other."""
        async with self._one_at_a_time:
            await self._command(number, params, tries)

    async def _command(self, number: int, params: Sequence[float], tries: int) -> None:
        filled = (*params, *(0.0 for _ in range(7 - len(params))))
        result: int | None = None
        for _ in range(tries):
            self.last.pop("COMMAND_ACK", None)
            self.send(mav.MAVLink_command_long_message(self.system_id, 1, number, 0, *filled))
            if await self.holds(lambda: self._acknowledged(number), _ANSWER_S):
                result = int(self.last["COMMAND_ACK"].result)
                if result == mav.MAV_RESULT_ACCEPTED:
                    return
                await self.holds(lambda: False, _ANSWER_S)
        said = "; ".join(text for _, text in self.texts[-4:])
        answer = f"command {number} was answered {result} (None: not at all)"
        raise LinkError(f"{answer}; the autopilot last said: {said}", where=self.url)

    def _acknowledged(self, number: int) -> bool:
        answer = self.last.get("COMMAND_ACK")
        return answer is not None and answer.command == number

    async def stream(self, rates_hz: dict[int, float]) -> None:
        """Have messages come at rates; asked for again until each has come (an autopilot that is not ready forgets)."""
        names = {number: str(mav.mavlink_map[number].msgname) for number in rates_hz}
        for name in names.values():
            self.last.pop(name, None)
        for _ in range(_TRIES):
            missing = [number for number, name in names.items() if name not in self.last]
            if not missing:
                return
            for number in missing:
                await self.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, number, round(1e6 / rates_hz[number]))
            await self.holds(lambda: all(name in self.last for name in names.values()), 2.0)
        raise LinkError(f"{', '.join(names[number] for number in missing)} did not come", where=self.url)

    async def build(self) -> str:
        """The hash of the autopilot's sources, from AUTOPILOT_VERSION: ArduPilot's is text, PX4's bytes, last one first."""
        await self.command(mav.MAV_CMD_REQUEST_MESSAGE, mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        await self.until("version", lambda: "AUTOPILOT_VERSION" in self.last, _ANSWER_S)
        raw = bytes(self.last["AUTOPILOT_VERSION"].flight_custom_version)
        return raw[::-1].hex() if self._is_px4 else raw.rstrip(b"\x00").decode("ascii", errors="replace")

    async def set_parameter(self, name: str, value: float) -> None:
        """PARAM_SET until PARAM_VALUE says the same."""
        await self._set_parameter(name, value, mav.MAV_PARAM_TYPE_REAL32, value)

    async def set_integer(self, name: str, value: int) -> None:
        """The same of PX4's integers, whose bytes travel as they are."""
        await self._set_parameter(name, float_of_int32(value), mav.MAV_PARAM_TYPE_INT32, value)

    async def _set_parameter(self, name: str, field: float, kind: int, value: float) -> None:
        def is_set() -> bool:
            return math.isclose(self._parameters.get(name, math.nan), value, rel_tol=1e-6, abs_tol=1e-12)

        for _ in range(_TRIES):
            self._parameters.pop(name, None)
            self.send(mav.MAVLink_param_set_message(self.system_id, 1, name.encode(), field, kind))
            if await self.holds(is_set, _ANSWER_S):
                return
        raise LinkError(f"parameter {name} did not become {value:g}", where=self.url, remedy="has this version that parameter?")

    async def set_origin(self, place: GeoPoint, timeout_s: float) -> None:
        """SET_GPS_GLOBAL_ORIGIN until GPS_GLOBAL_ORIGIN says the same: one that is not ready ignores it without a word."""
        lat, lon, alt = round(place.lat_deg * 1e7), round(place.lon_deg * 1e7), round(place.h_amsl_m * 1e3)

        def is_set() -> bool:
            told = self.last.get("GPS_GLOBAL_ORIGIN")
            return told is not None and abs(told.latitude - lat) < 10 and abs(told.longitude - lon) < 10

        for _ in range(max(1, round(timeout_s / _ANSWER_S))):
            self.send(mav.MAVLink_set_gps_global_origin_message(self.system_id, lat, lon, alt))
            if await self.holds(is_set, _ANSWER_S):
                return
        raise LinkError("the autopilot does not take an origin", where=self.url)

    # ------------------------------------------------------------------------------------------------------------ mission

    async def upload(self, items: Sequence[MissionItem]) -> None:
        """Give the autopilot a mission (ArduPilot wants home as its first item)."""
        self._items = items
        for _ in range(_TRIES):
            self.last.pop("MISSION_ACK", None)
            self.send(mav.MAVLink_mission_count_message(self.system_id, 1, len(items)))
            answered = await self.holds(lambda: "MISSION_ACK" in self.last, 10.0)
            if answered and self.last["MISSION_ACK"].type == mav.MAV_MISSION_ACCEPTED:
                return
        answer = self.last.get("MISSION_ACK")
        raise LinkError(f"the mission was answered {None if answer is None else answer.type}", where=self.url)

    def _answer_mission(self, number: int) -> None:
        if number < len(self._items):
            item = self._items[number]
            place = round(item.lat_deg * 1e7), round(item.lon_deg * 1e7), item.height_m
            placed = item.command <= mav.MAV_CMD_NAV_LAST  # PX4 refuses other commands with a place
            frame = mav.MAV_FRAME_GLOBAL_RELATIVE_ALT if placed else mav.MAV_FRAME_MISSION
            self.send(
                mav.MAVLink_mission_item_int_message(
                    self.system_id, 1, number, frame, item.command, int(number == 0), 1, *item.params, *place
                )
            )
