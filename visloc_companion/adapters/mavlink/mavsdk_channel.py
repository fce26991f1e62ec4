"""Packets through MAVSDK (4.x), which owns the socket or serial line and runs threads of its own.

MAVSDK hands every message to a callback in its thread; the asyncio streams that it offers on top are queues without bound. Here
what waits for the loop is bounded, the newest is kept, and at most one wake-up of the loop is under way.

What differs from the other channels: MAVSDK sends a heartbeat of its own each second (of our ids, type ONBOARD_CONTROLLER) and
asks a new autopilot once for its version; a listening connection sends to everybody that it hears; nothing can be signed.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

from visloc_companion.adapters.mavlink.channels import Address, Channel, Listener
from visloc_companion.adapters.mavlink.endpoint import Endpoint, EndpointKind
from visloc_companion.adapters.mavlink.mavsdk_translate import Spoken, Translator
from visloc_companion.errors import ConfigError

CAPACITY = 512
_SCHEMES = {
    EndpointKind.UDPIN: "udpin",
    EndpointKind.UDPOUT: "udpout",
    EndpointKind.TCP: "tcpout",
    EndpointKind.TCPIN: "tcpin",
    EndpointKind.SERIAL: "serial",
}


class Inbox:
    """From MAVSDK's thread to the loop: holds the newest messages, CAPACITY at most; `dropped` counts what gave way."""

    def __init__(self, loop: asyncio.AbstractEventLoop, wake: Callable[[], None]) -> None:
        self.dropped = 0
        self._loop, self._wake = loop, wake
        self._lock = threading.Lock()
        self._waiting: deque[Spoken] = deque()
        self._woken = False

    def put(self, spoken: Spoken) -> None:
        """Take a message; called in MAVSDK's thread."""
        with self._lock:
            self._waiting.append(spoken)
            if len(self._waiting) > CAPACITY:
                self._waiting.popleft()
                self.dropped += 1
            woken, self._woken = self._woken, True
        if not woken:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(self._wake)

    def drain(self) -> list[Spoken]:
        """All that waits, oldest first; called in the loop."""
        with self._lock:
            self._woken = False
            waiting = list(self._waiting)
            self._waiting.clear()
        return waiting


class MavsdkChannel:
    """channels.Channel over one `Mavsdk` object; `library` is the module mavsdk, or what stands for it in a test."""

    port: int | None = None

    def __init__(self, library: Any, system_id: int, component_id: int, listener: Listener) -> None:
        self.asked_system_id = system_id
        self._lost_packets = 0
        self._listener = listener
        self._translator = Translator()
        loop = asyncio.get_running_loop()
        self._inbox = Inbox(loop, self._receive)
        self._library = library
        configuration = library.Configuration.create_with_component_type(library.ComponentType.COMPANION_COMPUTER)
        configuration.system_id, configuration.component_id = system_id, component_id
        self._mavsdk = library.Mavsdk(configuration)
        self._configuration = configuration
        self._directs: dict[int, Any] = {}
        self._mavsdk.subscribe_on_new_system(lambda _user: self._schedule_attach(loop))

    @property
    def dropped(self) -> int:
        """Messages that were not sent, or came and were not read in time."""
        return self._lost_packets + self._inbox.dropped

    def connect(self, endpoint: Endpoint) -> None:
        """Open the connection; blocks. Raises OSError."""
        url = f"{_SCHEMES[endpoint.kind]}://{endpoint.place}:{endpoint.number}"
        try:
            self._mavsdk.add_any_connection_with_handle(url)
        except Exception as why:
            raise OSError(f"MAVSDK: {why}") from why

    def write(self, packets: list[bytes]) -> None:
        """Send packets; MAVSDK takes none before it has heard a vehicle."""
        for packet in packets:
            spoken = self._translator.spoken(packet)
            if spoken.system_id != self.asked_system_id:
                self.asked_system_id = spoken.system_id
                self._listener.on_lost(f"MAVSDK must begin again to speak as system {spoken.system_id}")
                return
            self._say(spoken)

    def speak_to(self, source: Address | None) -> None:
        """MAVSDK speaks to all that it hears."""

    def close(self) -> None:
        """Release the connection and MAVSDK's threads."""
        self._listener = _DEAF
        self._directs.clear()
        self._mavsdk.destroy()
        self._configuration.destroy()

    def _say(self, spoken: Spoken) -> None:
        direct = next(iter(self._directs.values()), None)
        if direct is None:
            self._lost_packets += 1
            return
        message = self._library.MavlinkMessage(spoken.name, spoken.system_id, spoken.component_id, 0, 0, spoken.fields_json)
        try:
            direct.send_message(message)
        except self._library.MavsdkError:
            self._lost_packets += 1

    def _schedule_attach(self, loop: asyncio.AbstractEventLoop) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(self._attach)

    def _attach(self) -> None:
        """Listen to every vehicle that MAVSDK has found; the session decides which one counts."""
        if self._listener is _DEAF:
            return
        for system in self._mavsdk.get_systems():
            system_id = system.get_system_id()
            if system_id not in self._directs:
                direct = self._directs[system_id] = self._library.MavlinkDirect(system)
                direct.subscribe_message("", self._heard)

    def _heard(self, message: Any, _user: Any) -> None:
        self._inbox.put(Spoken(message.message_name, message.system_id, message.component_id, message.fields_json))

    def _receive(self) -> None:
        packets = [self._translator.packet(spoken) for spoken in self._inbox.drain()]
        data = b"".join(packet for packet in packets if packet is not None)
        if data:
            self._listener.on_data(data, None)


_DEAF = Listener(lambda _data, _source: None, lambda _why: None, lambda: False, lambda _who: None)


class MavsdkOpener:
    """Opens such channels; remembers as which system the vehicle wants us to speak."""

    def __init__(self, system_id: int, component_id: int, library: Any = None) -> None:
        self._library = load_library() if library is None else library
        self._system_id, self._component_id = system_id or 1, component_id
        self._latest: MavsdkChannel | None = None

    async def __call__(self, endpoint: Endpoint, listener: Listener) -> Channel:
        """A connected channel. Raises OSError."""
        if self._latest is not None:
            self._system_id = self._latest.asked_system_id
        channel = self._latest = MavsdkChannel(self._library, self._system_id, self._component_id, listener)
        connecting = asyncio.get_running_loop().run_in_executor(None, channel.connect, endpoint)
        try:
            await asyncio.shield(connecting)
        except asyncio.CancelledError:
            connecting.add_done_callback(partial(_close_after, channel))
            raise
        except BaseException:
            channel.close()
            raise
        return channel


def _close_after(channel: MavsdkChannel, connecting: asyncio.Future[None]) -> None:
    """What MAVSDK still works on in a thread may not be destroyed under it."""
    if not connecting.cancelled():
        connecting.exception()
    channel.close()


def load_library() -> Any:
    """The parts of MAVSDK that are used here, under one name. Raises ConfigError where it is not installed."""
    try:
        import mavsdk
        from mavsdk.plugins import mavlink_direct
    except ImportError as why:
        remedy = "pip install 'visloc-companion[mavsdk]', or link.backend = \"pymavlink\""
        raise ConfigError(f"cannot be loaded: {why}", where="link.backend = mavsdk", remedy=remedy) from why
    mavsdk.log_subscribe(lambda level, _text, _file, _line: level < mavsdk.LogLevel.ERROR)  # it writes to the standard output

    class Library:
        """What is used of it."""

        Configuration, ComponentType = mavsdk.Configuration, mavsdk.ComponentType
        Mavsdk, MavsdkError = mavsdk.Mavsdk, mavsdk.MavsdkError
        MavlinkDirect, MavlinkMessage = mavlink_direct.MavlinkDirect, mavlink_direct.MavlinkMessage

    return Library
