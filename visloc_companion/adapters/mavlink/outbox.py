"""What is to be sent: MAVLink 2 packets, bounded."""

from __future__ import annotations

from collections import deque

from visloc_companion.adapters.mavlink.dialect import Message, mav

MAX_BYTES = 65_536


class Outbox:
    """Packs messages in order of `put`; when nobody drains it, the oldest packets give way and are counted."""

    def __init__(self, component_id: int) -> None:
        self.dropped = 0
        self._packer = mav.MAVLink(None, srcSystem=1, srcComponent=component_id)
        self._packets: deque[bytes] = deque()
        self._n_bytes = 0

    def speak_as(self, system_id: int) -> None:
        """The system id of what is sent from now on: the vehicle's (PX4 counts heartbeats only of its own system)."""
        self._packer.srcSystem = system_id

    def put(self, message: Message) -> None:
        """Pack a message as MAVLink 2."""
        packet = message.pack(self._packer)
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
