"""The other side's signing, as pymavlink does it: an implementation that is not the one under test."""

from __future__ import annotations

from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.adapters.mavlink.signing import is_signed


class PymavlinkSigning:
    """Signs and checks with pymavlink. `stamp` counts packets and follows what was heard, as ArduPilot's does; `refused` counts.

    With `accepts_unsigned` unsigned packets pass, as on ArduPilot's first channel.
    """

    def __init__(self, key: bytes, stamp: int, link_id: int = 0, accepts_unsigned: bool = False) -> None:
        self.refused = 0
        self._accepts_unsigned = accepts_unsigned
        self._mav = mav.MAVLink(None)
        self._mav.signing.secret_key = key
        self._mav.signing.timestamp = stamp
        self._mav.signing.link_id = link_id
        self._mav.signing.sign_outgoing = True

    @property
    def stamp(self) -> int:
        """The time stamp of the next packet."""
        return int(self._mav.signing.timestamp)

    def pack(self, message: Message, packer: Message) -> bytes:
        """A signed packet of a message, by the ids and the sequence number of `packer`."""
        packer.signing = self._mav.signing
        return bytes(message.pack(packer))

    def admits(self, frame: bytearray, _message_id: int) -> bool:
        """Whether a packet is believed."""
        believed = self._mav.check_signature(frame, frame[5], frame[6]) if is_signed(frame) else self._accepts_unsigned
        self.refused += not believed
        return bool(believed)
