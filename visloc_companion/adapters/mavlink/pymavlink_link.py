"""The MAVLink link of the daemon: an asyncio shell around `session.MavlinkSession` (protocols.AutopilotLink)."""

from __future__ import annotations

import asyncio
import errno
import os
from collections.abc import AsyncIterator, Callable

from visloc_companion.adapters.mavlink.channels import Address, Channel, Listener, OpenChannel, open_network_channel
from visloc_companion.adapters.mavlink.endpoint import Endpoint, EndpointKind, parse_endpoint
from visloc_companion.adapters.mavlink.event_queue import EventQueue
from visloc_companion.adapters.mavlink.serial_channel import SerialChannel
from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.adapters.mavlink.streams import StreamState
from visloc_companion.protocols import Clock
from visloc_companion.types import EkfSource, Event, Injection, Notice, Report, RequestMessage, SourceSwitched, SwitchSource

_NS_PER_S = 1_000_000_000
_POLL_NS = _NS_PER_S // 20
_MAX_PAUSE_S = 10.0

RawTap = Callable[[bytes, int, bool], None]
"""`on_raw(data, t_ns, outgoing)`: every piece of bytes as it went over the link."""


class PymavlinkLink:
    """One connection to one autopilot, opened by the first call and reopened by itself until `close`.

    `request` and `switch` wait for the autopilot (seconds): a caller that must not wait runs them as tasks; the request goes on
    being seen to whether or not somebody waits. `on_warning` gets one line for what an operator may want to know.
    `open_channel` makes the connection: our own (UDP, TCP, serial) unless told otherwise (mavsdk_channel.py).
    Raises ConfigError for a URL that is not valid.
    """

    def __init__(
        self,
        url: str,
        settings: SessionSettings,
        clock: Clock,
        *,
        on_raw: RawTap | None = None,
        on_warning: Callable[[str], None] | None = None,
        open_channel: OpenChannel | None = None,
        capacity: int = 2000,
    ) -> None:
        self.endpoint: Endpoint = parse_endpoint(url)
        self.session = MavlinkSession(settings)
        self.reconnects = self._rounds = 0
        self._clock = clock
        self._on_raw = on_raw
        self._on_warning = on_warning
        self._queue = EventQueue(capacity)
        self._open_channel = open_own_channel if open_channel is None else open_channel
        self._channel: Channel | None = None
        self._lost: str | None = None
        self._slow_told = False
        self._left_out = 0
        self._data_ns = 0
        self._task: asyncio.Task[None] | None = None
        self._closed = False
        self._switched: dict[EkfSource, asyncio.Future[bool]] = {}

    @property
    def port(self) -> int | None:
        """The local port while the connection is open (of use where port 0 let the system choose)."""
        return None if self._channel is None else self._channel.port

    @property
    def rounds(self) -> int:
        """How often the connection was seen to so far: about 20 times a second, whatever is heard."""
        return self._rounds

    @property
    def withheld(self) -> str:
        """Why positions are not sent that are to be, in a few words; empty where they are."""
        return self.session.withheld

    @property
    def n_sent(self) -> int:
        """How many positions went out so far."""
        return self.session.n_sent

    @property
    def left_out(self) -> int:
        """How many messages a serial line was too slow for so far; a network has none of these."""
        return self._left_out + _too_slow_for(self._channel)

    @property
    def dropped_events(self) -> int:
        """Events that gave way because nobody read them."""
        return self._queue.dropped

    def open(self) -> None:
        """Begin to connect, in the background. Every other call does it too."""
        if self._task is None and not self._closed:
            self._task = asyncio.get_running_loop().create_task(self._run(), name=f"mavlink {self.endpoint}")

    def events(self) -> AsyncIterator[Event]:
        """Decoded events, stamped with arrival time, until `close`."""
        self.open()
        return self._queue

    async def send(self, injection: Injection) -> None:
        """Send an external position, at once; dropped (and counted by the session) while no origin is known."""
        if self._ready():
            self.session.send(injection, self._clock.now_ns())
            self._flush()

    async def request(self, message: RequestMessage) -> bool:
        """Ask for a message rate; True when it arrives at about that rate, False after three judged failures."""
        if not self._ready():
            return False
        self.session.request(message, self._clock.now_ns())
        while not self._closed and self.session.stream_state(message.message_id) is StreamState.PENDING:
            await self._clock.sleep_until(self._clock.now_ns() + _POLL_NS)
        return self.session.stream_state(message.message_id) is StreamState.ARRIVING

    async def switch(self, source: SwitchSource) -> bool:
        """Switch the autopilot's position source; True when it confirmed. The event says so too."""
        if not self._ready():
            return False
        waiting = self._switched.get(source.source)
        if waiting is None:
            waiting = self._switched[source.source] = asyncio.get_running_loop().create_future()
            self.session.switch(source, self._clock.now_ns())
            self._flush()
        return await asyncio.shield(waiting)

    async def notify(self, notice: Notice) -> None:
        """Send a STATUSTEXT where the notice is for the operator."""
        if self._ready():
            self.session.notify(notice, self._clock.now_ns())
            self._flush()

    async def report(self, report: Report) -> None:
        """Send what ground stations show of the companion, and let the heartbeat show whether it is critical."""
        if self._ready():
            self.session.report(report, self._clock.now_ns())
            self._flush()

    async def close(self) -> None:
        """Stop sending at once and release the socket or port; `events` ends."""
        self._closed = True
        if self._channel is not None:
            self._channel.close()
            self._channel = None
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        for waiting in self._switched.values():
            if not waiting.done():
                waiting.set_result(False)
        self._queue.close()
        await asyncio.sleep(0)

    # ------------------------------------------------------------------------------------------------------------ inside

    def _ready(self) -> bool:
        self.open()
        return not self._closed

    async def _run(self) -> None:
        try:
            pause_s = self.session.settings.reconnect_s
            while True:
                if await self._connect():
                    pause_s = self.session.settings.reconnect_s
                    await self._serve()
                    self.reconnects += 1
                came_back = await self._pause(pause_s)
                pause_s = self.session.settings.reconnect_s if came_back else min(2 * pause_s, _MAX_PAUSE_S)
        except Exception as why:
            self._queue.close(why)

    async def _connect(self) -> bool:
        self._lost = None
        listener = Listener(self._received, self._connection_lost, lambda: self.session.link.up, self._stranger)
        try:
            self._channel = await self._open_channel(self.endpoint, listener)
        except OSError as why:
            taken = "another program has it (ss -tulpn names it); " if why.errno == errno.EADDRINUSE else ""
            self._warn(f"cannot open {self.endpoint}: {why}; {taken}trying again")
            return False
        self._data_ns = self._clock.now_ns()
        return True

    async def _serve(self) -> None:
        """Poll while the connection stands; a silent stream connection is given up, since it may be half open."""
        stream = self.endpoint.kind in (EndpointKind.TCP, EndpointKind.SERIAL)
        patience_ns = round((self.session.settings.timeout_s + self.session.settings.reconnect_s) * _NS_PER_S)
        while self._lost is None:
            now_ns = self._clock.now_ns()
            self._poll(now_ns)
            if stream and now_ns - self._data_ns > patience_ns:
                self._lost = "nothing arrives"
            await self._clock.sleep_until(now_ns + _POLL_NS)
        self._emit(self.session.disconnected(f"lost {self.endpoint}: {self._lost}; opening it again", self._clock.now_ns()))
        if self._channel is not None:
            self._left_out += _too_slow_for(self._channel)
            self._channel.close()
            self._channel = None

    async def _pause(self, pause_s: float) -> bool:
        """Wait, and let the session notice the silence meanwhile; True, and at once, where a device that was gone is there."""
        until_ns = self._clock.now_ns() + round(pause_s * _NS_PER_S)
        was_gone = self._device_gone()
        while (now_ns := self._clock.now_ns()) < until_ns:
            self._poll(now_ns)
            await self._clock.sleep_until(min(until_ns, now_ns + _POLL_NS))
            if was_gone and not self._device_gone():
                return True
        return False

    def _device_gone(self) -> bool:
        return self.endpoint.kind is EndpointKind.SERIAL and not os.path.lexists(self.endpoint.place)

    def _poll(self, now_ns: int) -> None:
        self._rounds += 1
        self._emit(self.session.poll(now_ns))
        self._flush()

    def _received(self, data: bytes, source: Address | None) -> None:
        now_ns = self._data_ns = self._clock.now_ns()
        if self._on_raw is not None:
            self._on_raw(data, now_ns, False)
        n_vouched = self.session.n_vouched
        events = self.session.receive(data, now_ns)
        if self._channel is not None and self.session.n_vouched > n_vouched:
            self._channel.speak_to(source)
        self._flush()
        self._emit(events)

    def _connection_lost(self, why: str) -> None:
        self._lost = why

    def _stranger(self, who: str) -> None:
        self._warn(f"{who} also speaks on {self.endpoint} and is ignored while the autopilot is heard")

    def _emit(self, events: list[Event]) -> None:
        for event in events:
            self._queue.put(event)
            if isinstance(event, SourceSwitched):
                waiting = self._switched.pop(event.source, None)
                if waiting is not None and not waiting.done():
                    waiting.set_result(event.accepted)
        for text in self.session.warnings():
            self._warn(text)

    def _flush(self) -> None:
        packets = self.session.packets()
        if self._channel is None or not packets:
            return
        self._channel.write(packets)
        if _too_slow_for(self._channel) and not self._slow_told:
            self._slow_told = True
            self._warn(f"{self.endpoint} cannot carry all that is sent, some is left out: raise the baud rate on both sides")
        if self._on_raw is not None:
            now_ns = self._clock.now_ns()
            for packet in packets:
                self._on_raw(packet, now_ns, True)

    def _warn(self, text: str) -> None:
        if self._on_warning is not None:
            self._on_warning(text)


def _too_slow_for(channel: Channel | None) -> int:
    return channel.overflowed if isinstance(channel, SerialChannel) else 0


async def open_own_channel(endpoint: Endpoint, listener: Listener) -> Channel:
    """A serial line, or a socket of ours. Raises OSError."""
    if endpoint.kind is EndpointKind.SERIAL:
        return SerialChannel(endpoint, listener)
    return await open_network_channel(endpoint, listener)
