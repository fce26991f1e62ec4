"""What is to be sent: MAVLink 2 packets, bounded, signed where there is a key, and only of what is on the list."""

from __future__ import annotations

from collections import deque
from typing import ClassVar

from visloc_companion.adapters.mavlink.allow_list import objection
from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.adapters.mavlink.signing import SigningSettings, SigningTime, sign_with
from visloc_companion.errors import LinkError

MAX_BYTES = 65_536


class Outbox:
    """Packs messages in order of `put`; when nobody drains it, the oldest packets give way and are counted.

    What allow_list.py objects to is a fault of this program: it is dropped and counted in `forbidden`, and `objection` says the
    latest; where `strict` is set, as in this project's tests, it raises LinkError.
    """

    strict: ClassVar[bool] = False

    def __init__(self, component_id: int, signing: SigningSettings | None = None, time: SigningTime | None = None) -> None:
        self.dropped = self.forbidden = 0
        self.objection = ""
        self._packer = mav.MAVLink(None, srcSystem=1, srcComponent=component_id)
        self._time = time
        self._packets: deque[bytes] = deque()
        self._n_bytes = 0
        if signing is not None:
            sign_with(self._packer, signing)

    def speak_as(self, system_id: int) -> None:
        """The system id of what is sent from now on: the vehicle's (PX4 counts heartbeats only of its own system)."""
        self._packer.srcSystem = system_id

    def put(self, message: Message) -> None:
        """Pack a message as MAVLink 2."""
        why = objection(message, self._packer.srcSystem)
        if why is not None:
            self._hold_back(why)
            return
        if self._time is not None:
            self._packer.signing.timestamp = self._time.next()
        packet = bytes(message.pack(self._packer))
        self._packer.seq = (self._packer.seq + 1) % 256
        self._packets.append(packet)
        self._n_bytes += len(packet)
        while self._n_bytes > MAX_BYTES:
            self._n_bytes -= len(self._packets.popleft())
            self.dropped += 1

    def drain(self) -> list[bytes]:
        """All packets, oldest first; they are forgotten."""
        packets = list(self._packets)
        self._packets.clear()
        self._n_bytes = 0
        return packets

    def _hold_back(self, why: str) -> None:
        self.forbidden += 1
        self.objection = why
        if self.strict:
            raise LinkError(f"must not be sent: {why}", remedy="this is a fault of visloc; please report it")
