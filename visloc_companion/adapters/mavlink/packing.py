"""Messages to packets for those that speak at once, on the machine's own clock; the daemon's session has its Outbox."""

from __future__ import annotations

import time

from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.adapters.mavlink.signing import SigningSettings, SigningTime, sign_with


class Packer:
    """Packs messages of a component as MAVLink 2, signed where there is a key."""

    def __init__(self, system_id: int, component_id: int, signing: SigningSettings | None = None) -> None:
        self._mav = mav.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._time = None if signing is None else SigningTime(signing.stamp_at_zero)
        if signing is not None:
            sign_with(self._mav, signing)

    def speak_as(self, system_id: int) -> None:
        """The system id of what is packed from now on."""
        self._mav.srcSystem = system_id

    def packet(self, message: Message) -> bytes:
        """The packet of a message, numbered in turn: receivers count what is lost."""
        if self._time is not None:
            self._time.advance(time.monotonic_ns())
            self._mav.signing.timestamp = self._time.next()
        packet = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return packet
