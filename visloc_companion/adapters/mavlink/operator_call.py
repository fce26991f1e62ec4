"""The ground's side of operator_position.py: tells a flying daemon where the vehicle is, over a link of a ground station's."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import dataclass

from visloc_companion.adapters.mavlink import operator_position
from visloc_companion.adapters.mavlink.channels import Address, Channel, Listener, OpenChannel
from visloc_companion.adapters.mavlink.codec import is_autopilot
from visloc_companion.adapters.mavlink.dialect import AUTOPILOT_COMPONENT, Message, mav
from visloc_companion.adapters.mavlink.encode import station_heartbeat
from visloc_companion.adapters.mavlink.endpoint import parse_endpoint
from visloc_companion.adapters.mavlink.framing import Framer
from visloc_companion.adapters.mavlink.packing import Packer
from visloc_companion.adapters.mavlink.signing import SigningSettings
from visloc_companion.errors import LinkError
from visloc_companion.types import GeoPoint

STATION_COMPONENT = mav.MAV_COMP_ID_MISSIONPLANNER
TRIES, PERIOD_S = 8, 1.0
ANSWERS = tuple(f"visloc: position {word}" for word in ("taken", "agrees", "refused"))
"""How they begin (core/vision.py); other texts of positions, as of one found on the map, are none."""
_NOT_YET = (None, mav.MAV_RESULT_TEMPORARILY_REJECTED)
_REFUSALS = {
    mav.MAV_RESULT_TEMPORARILY_REJECTED: "it has no origin from the autopilot yet",
    mav.MAV_RESULT_DENIED: "it is no place to fly, or no accuracy",
    mav.MAV_RESULT_UNSUPPORTED: "it does not know this command; is it an older version?",
}


@dataclass(frozen=True, slots=True)
class Caller:
    """Who speaks: a system among the daemon's `link.operator_systems`; `component_id` is the daemon's; its key, if any."""

    system_id: int = 255
    component_id: int = 197
    signing: SigningSettings | None = None


class _Call:
    def __init__(self, caller: Caller, open_channel: OpenChannel) -> None:
        self.component_id, self._open_channel = caller.component_id, open_channel
        self._framer = Framer()
        self._packer = Packer(caller.system_id, STATION_COMPONENT, caller.signing)
        self._channel: Channel | None = None
        self._changed = asyncio.Event()
        self.vehicle = 0
        self.result: int | None = None
        self.said = ""
        self.lost = ""

    async def open(self, url: str) -> None:
        listener = Listener(self._received, self._on_lost, lambda: self.vehicle != 0, lambda _who: None)
        try:
            self._channel = await self._open_channel(parse_endpoint(url), listener)
        except OSError as why:
            remedy = "name the ground station's own link to the vehicle; a port that another program has cannot be shared"
            raise LinkError(f"cannot be opened: {why}", where=url, remedy=remedy) from why

    def close(self) -> None:
        if self._channel is not None:
            self._channel.close()

    def send(self, message: Message) -> None:
        if self._channel is not None:
            self._channel.write([self._packer.packet(message)])

    def beat(self) -> None:
        self.send(station_heartbeat())

    async def changed(self, timeout_s: float) -> None:
        """Until something came, at most so long. Raises LinkError where the connection is gone."""
        self._changed.clear()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._changed.wait(), timeout_s)
        if self.lost:
            raise LinkError(self.lost, where="link", remedy="connect again")

    def _on_lost(self, why: str) -> None:
        self.lost = why or "the connection is gone"
        self._changed.set()

    def _received(self, data: bytes, source: Address | None) -> None:
        for message in self._framer.feed(data):
            if message.get_srcComponent() == AUTOPILOT_COMPONENT and message.get_type() == "HEARTBEAT" and is_autopilot(message):
                self.vehicle = self.vehicle or message.get_srcSystem()
                if self._channel is not None:
                    self._channel.speak_to(source)
            elif message.get_srcComponent() == self.component_id and message.get_srcSystem() == self.vehicle:
                self._take(message)
            self._changed.set()

    def _take(self, message: Message) -> None:
        if message.get_type() == "COMMAND_ACK" and message.command == operator_position.COMMAND:
            self.result = message.result
        elif message.get_type() == "STATUSTEXT" and message.text.startswith(ANSWERS):
            self.said = message.text


async def say_here(
    url: str, place: GeoPoint, sigma_m: float, caller: Caller, open_channel: OpenChannel, period_s: float = PERIOD_S
) -> str:
    """What the daemon answers to "the vehicle is at `place`, to `sigma_m` (1-sigma)".

    Said TRIES times, `period_s` apart, until it is heard and the daemon is ready. Raises LinkError where nothing answers, where
    the daemon refuses the command, or where it acknowledges it and its answer is not heard within TRIES / 2 periods.
    """
    call = _Call(caller, open_channel)
    await call.open(url)
    try:
        result = await _answered(call, place, sigma_m, period_s)
        if result != mav.MAV_RESULT_ACCEPTED:
            why = _REFUSALS.get(result, f"MAV_RESULT {result}")
            raise LinkError(f"the daemon refuses: {why}", where=url, remedy="see docs/start-anywhere.md")
        if not await _answer(call, TRIES / 2 * period_s):
            remedy = "look at its texts on the ground station, or say it again"
            raise LinkError("the daemon has heard it, but its answer did not come: taken or refused?", where=url, remedy=remedy)
        return call.said
    finally:
        call.close()


async def _answer(call: _Call, timeout_s: float) -> str:
    """The text; "" where none comes in time, however much else comes."""
    loop = asyncio.get_running_loop()
    until_s = loop.time() + timeout_s
    while not call.said and (left_s := until_s - loop.time()) > 0:
        await call.changed(left_s)
    return call.said


async def _answered(call: _Call, place: GeoPoint, sigma_m: float, period_s: float) -> int:
    """The daemon's MAV_RESULT."""
    result: int | None = None
    for _ in range(TRIES):
        result = await _asked_once(call, place, sigma_m, period_s)
        if result not in _NOT_YET:
            break
    if result is not None:
        return result
    if not call.vehicle:
        raise LinkError("no autopilot is heard", where="link", remedy="is this the link on which the vehicle sends?")
    raise LinkError(
        f"no daemon answers as component {call.component_id}",
        where="link",
        remedy="is it running, is this system among its link.operator_systems, does the autopilot pass messages on "
        "(docs/mavlink.md), and do both have the same signing key?",
    )


async def _asked_once(call: _Call, place: GeoPoint, sigma_m: float, period_s: float) -> int | None:
    loop = asyncio.get_running_loop()
    call.beat()
    call.result = None
    if call.vehicle:
        call.send(operator_position.command(call.vehicle, call.component_id, place, sigma_m))
    next_s = loop.time() + period_s
    while call.result in _NOT_YET and (left_s := next_s - loop.time()) > 0:
        await call.changed(left_s)
    return call.result
