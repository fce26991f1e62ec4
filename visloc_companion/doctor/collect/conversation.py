"""A conversation with one autopilot over a link of the doctor's own, as the vehicle's component 191.

It answers the autopilot's TIMESYNC, measures its own, counts what comes, and keeps the newest message of each type.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import Counter
from collections.abc import Callable

from visloc_companion.adapters.mavlink.channels import Address, Channel, Listener, open_network_channel
from visloc_companion.adapters.mavlink.codec import autopilot_kind, is_autopilot
from visloc_companion.adapters.mavlink.codec_gimbal import NAME as GIMBAL_ATTITUDE
from visloc_companion.adapters.mavlink.codec_gimbal import is_of_gimbal
from visloc_companion.adapters.mavlink.dialect import AUTOPILOT_COMPONENT, Message, mav
from visloc_companion.adapters.mavlink.encode import command_long, heartbeat
from visloc_companion.adapters.mavlink.endpoint import EndpointKind, parse_endpoint
from visloc_companion.adapters.mavlink.framing import Framer
from visloc_companion.adapters.mavlink.packing import Packer
from visloc_companion.adapters.mavlink.serial_channel import SerialChannel
from visloc_companion.adapters.mavlink.signing import SigningSettings, is_signed, is_signed_with
from visloc_companion.adapters.mavlink.timesync import Timesync
from visloc_companion.doctor.collect.numbers import Numbers
from visloc_companion.errors import LinkError
from visloc_companion.types import AutopilotKind, TimesyncSample

COMPONENT = 191
"""MAV_COMP_ID_ONBOARD_COMPUTER: not the daemon's, which may be running."""
HEARTBEAT_S, LOOK_S = 1.0, 0.1


class Conversation:
    """`last` holds the autopilot's newest message of each type, `counts` how many came. Listeners get each message.

    `system_id` 0 takes the first autopilot that is heard. What comes is read whether or not it is
    signed; `signed` says which, `another_key` that it was signed with another key than ours. `strangers` are addresses that speak
    on the same port and are not listened to, as the daemon would not.
    """

    def __init__(self, url: str, system_id: int = 0, signing: SigningSettings | None = None) -> None:
        self.endpoint = parse_endpoint(url)
        self.system_id = system_id
        self.last: dict[str, Message] = {}
        self.counts: Counter[str] = Counter()
        self.listeners: list[Callable[[Message], None]] = []
        self.samples: list[TimesyncSample] = []
        self.pointed: list[Message] = []
        self.timesync_requests = 0
        self.mavlink_version = 0
        self.autopilots: set[int] = set()
        self.others: set[tuple[int, int]] = set()
        self.strangers: set[str] = set()
        self.bytes_in = 0
        self._numbers = Numbers()
        self._framer = Framer()
        self._timesync = Timesync()
        self.signed = self.another_key = False
        self._key = None if signing is None else signing.key
        self._packer = Packer(1, COMPONENT, signing)
        self._channel: Channel | None = None
        self._changed = asyncio.Event()
        self._heartbeat: asyncio.Task[None] | None = None
        self.lost = ""

    # ------------------------------------------------------------------------------------------------------- opening

    async def open(self) -> None:
        """Open the line and begin to say that somebody is there. Raises LinkError where it cannot be opened."""
        listener = Listener(self._received, self._connection_lost, lambda: bool(self.last), self.strangers.add)
        try:
            if self.endpoint.kind is EndpointKind.SERIAL:
                self._channel = SerialChannel(self.endpoint, listener)
            else:
                self._channel = await open_network_channel(self.endpoint, listener)
        except OSError as why:
            raise LinkError(
                f"cannot be opened: {why}",
                where=str(self.endpoint),
                remedy="see that the device or address is right, that you may use it (group dialout), and that no other "
                "program has it (stop the daemon: systemctl stop visloc)",
            ) from why
        self._heartbeat = asyncio.get_running_loop().create_task(self._beat())

    async def close(self) -> None:
        """Release the line."""
        if self._heartbeat is not None:
            self._heartbeat.cancel()
            await asyncio.gather(self._heartbeat, return_exceptions=True)
        if self._channel is not None:
            self._channel.close()
        await asyncio.sleep(0)

    @property
    def port(self) -> int | None:
        """The local port while the line is open."""
        return None if self._channel is None else self._channel.port

    @property
    def kind(self) -> AutopilotKind:
        """Which autopilot it is."""
        told = self.last.get("HEARTBEAT")
        return AutopilotKind.UNKNOWN if told is None else autopilot_kind(told)

    @property
    def armed(self) -> bool:
        """Whether it is armed."""
        told = self.last.get("HEARTBEAT")
        return told is not None and bool(told.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)

    @property
    def garbage_share(self) -> float:
        """Bytes so far that were no message, of all."""
        return self._framer.counts.garbage_bytes / max(1, self.bytes_in)

    @property
    def lost_share(self) -> float:
        """Messages of the autopilot that did not arrive, of all that it sent so far."""
        return self._numbers.lost_share(self._framer.counts.unknown)

    # ------------------------------------------------------------------------------------------------------- talking

    def send(self, message: Message) -> None:
        """Send a message at once, signed where there is a key."""
        if self._channel is not None:
            self._channel.write([self._packer.packet(message)])

    def command(self, number: int, *params: float) -> None:
        """Send a COMMAND_LONG; its COMMAND_ACK comes as any message."""
        self.send(command_long(self.system_id, number, *params))

    def ask_time(self) -> None:
        """Send a TIMESYNC request; the sample is in `samples` once it is answered."""
        self.send(self._timesync.ask(time.monotonic_ns()))

    async def until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait until a condition holds, looking at every arrival; False after `timeout_s`."""
        loop = asyncio.get_running_loop()
        deadline = loop.time() + timeout_s
        while not condition():
            left_s = deadline - loop.time()
            if left_s <= 0:
                return False
            self._changed.clear()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._changed.wait(), min(LOOK_S, left_s))
        return True

    # -------------------------------------------------------------------------------------------------------- inside

    async def _beat(self) -> None:
        while True:
            self.send(heartbeat(mav.MAV_STATE_STANDBY))
            await asyncio.sleep(HEARTBEAT_S)

    def _connection_lost(self, why: str) -> None:
        self.lost = why
        self._changed.set()

    def _received(self, data: bytes, source: Address | None) -> None:
        now_ns = time.monotonic_ns()
        self.bytes_in += len(data)
        for message in self._framer.feed(data):
            if self._is_ours(message):
                if self._channel is not None:
                    self._channel.speak_to(source)
                self._take(message, now_ns)
            elif is_of_gimbal(message) and message.get_srcSystem() == self.system_id:
                self.pointed.append(message)
        self._changed.set()

    def _is_ours(self, message: Message) -> bool:
        system, component = message.get_srcSystem(), message.get_srcComponent()
        if message.get_type() == "HEARTBEAT":
            pilot = component == AUTOPILOT_COMPONENT and is_autopilot(message)
            if not pilot:
                self.others.add((system, component))
                return False
            self.autopilots.add(system)
            if self.system_id == 0:
                self.system_id = system
        return bool(system == self.system_id and component == AUTOPILOT_COMPONENT)

    def _take(self, message: Message, now_ns: int) -> None:
        kind = message.get_type()
        self._packer.speak_as(self.system_id)
        frame = message.get_msgbuf()
        self.mavlink_version = 1 if frame[0] == mav.PROTOCOL_MARKER_V1 else 2
        self.signed = is_signed(frame)
        self.another_key = self.signed and self._key is not None and not is_signed_with(self._key, frame)
        self._numbers.take(message.get_seq())
        self.last[kind] = message
        self.counts[kind] += 1
        if kind == GIMBAL_ATTITUDE:
            self.pointed.append(message)
        if kind == "TIMESYNC":
            reply, sample = self._timesync.take(message, now_ns)
            if reply is not None:
                self.timesync_requests += 1
                self.send(reply)
            if sample is not None:
                self.samples.append(sample)
        for listener in self.listeners:
            listener(message)
