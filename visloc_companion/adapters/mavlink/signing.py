"""MAVLink 2 signing without I/O: stamps for what is sent, and the judgement of what comes.

A signed packet ends in 13 bytes: the link id, a time stamp (48 bits, units of 10 us since 2015-01-01) and the first 48 bits of
SHA-256 over the key and the packet (mavlink.io, "Message Signing"). What is sent is signed by pymavlink. What comes is judged
here and not by pymavlink, which notes the time stamp of a packet before it has checked its signature: one forged packet with a
stamp of the far future would shut out the real sender.
"""

from __future__ import annotations

import hashlib
import hmac
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from visloc_companion.adapters.mavlink.dialect import mav

KEY_BYTES = 32
UNITS_PER_S = 100_000
EPOCH_UNIX_S = 1_420_070_400
"""2015-01-01T00:00:00Z."""
MAX_STREAMS = 32
KEEP_EVERY_NS = 30_000_000_000
_NS_PER_UNIT = 10_000
_NEW_STREAM_UNITS = 60 * UNITS_PER_S
_LAST_STAMP = 2**48 - 1
_BLOCK, _SIGNATURE = 13, 6
_FLAGS_AT, _SYSTEM_AT, _COMPONENT_AT, _SYSTEM_AT_V1 = 2, 5, 6, 3
_UNSIGNED_AS_ON_ARDUPILOT = frozenset((mav.MAVLINK_MSG_ID_RADIO, mav.MAVLINK_MSG_ID_RADIO_STATUS))
"""Telemetry radios put these in and know no key."""


@dataclass(frozen=True, slots=True)
class SigningSettings:
    """The key that both sides share, our own link id, and what is believed without a signature.

    `stamp_at_zero` is the time stamp of the instant at which our monotonic clock would read 0 (`stamp_at_zero` below).
    `keep` is given the newest stamp every 30 s, to be remembered over a restart (signing_stamp.py).
    """

    key: bytes = field(repr=False)
    link_id: int = 0
    accept_unsigned: bool = False
    stamp_at_zero: int = 0
    keep: Callable[[int], None] | None = field(default=None, repr=False)


def stamp_at_zero(unix_ns: int, now_ns: int) -> int:
    """The stamp that belongs to `now_ns = 0`, where the wall clock reads `unix_ns` now. Negative where that was before 2015."""
    return (unix_ns - EPOCH_UNIX_S * 1_000_000_000 - now_ns) // _NS_PER_UNIT


def at_zero_of(stamp: int, now_ns: int) -> int:
    """The same, where `stamp` is to be that of now."""
    return stamp - now_ns // _NS_PER_UNIT


def sign_with(packer: Any, settings: SigningSettings) -> None:
    """Let a packer of pymavlink's sign all that it packs; it takes the time stamps from `packer.signing.timestamp`."""
    packer.signing.secret_key, packer.signing.link_id = settings.key, settings.link_id
    packer.signing.sign_outgoing = True


class SigningTime:
    """Our time stamp: the wall clock's, never repeated, never behind what a holder of the key has said."""

    def __init__(self, at_zero: int, keep: Callable[[int], None] | None = None) -> None:
        self._at_zero = at_zero
        self._latest = max(0, at_zero)
        self._keep = keep
        self._keep_ns = 0

    @property
    def latest(self) -> int:
        """The newest stamp that was given or heard, or the time now."""
        return self._latest

    def advance(self, now_ns: int) -> None:
        """Let time pass."""
        self._latest = max(self._latest, min(_LAST_STAMP, self._at_zero + now_ns // _NS_PER_UNIT))
        if self._keep is not None and now_ns >= self._keep_ns:
            self._keep_ns = now_ns + KEEP_EVERY_NS
            self._keep(self._latest)

    def heard(self, stamp: int) -> None:
        """A packet with a right signature carried this stamp: a clock of ours that is behind follows."""
        self._latest = max(self._latest, stamp)

    def next(self) -> int:
        """A stamp for one packet."""
        self._latest = min(_LAST_STAMP, self._latest + 1)
        return self._latest


class Refusal(StrEnum):
    """Why a packet is not believed."""

    UNSIGNED = "unsigned"
    WRONG = "wrong"
    REPLAYED = "replayed"
    STALE = "stale"
    """The first one of a stream, with a right signature and more than a minute behind our time."""
    CROWDED = "crowded"


_TOLD = {
    Refusal.UNSIGNED: "unsigned messages are refused: set up signing there, or link.accept_unsigned",
    Refusal.WRONG: "messages with a wrong signature are refused: has the autopilot the key of link.signing_key_file?",
    Refusal.REPLAYED: "signed messages came a second time and are refused: a loop in the routing, or somebody replays them",
    Refusal.STALE: "signed messages with an old time are refused until the sender has heard ours (an old recording, or no clock)",
    Refusal.CROWDED: f"more than {MAX_STREAMS} senders sign with our key: further ones are refused",
}


class SignatureGuard:
    """Decides which packets are believed; `counts` has the refused ones by reason, each reason told of once.

    A stream is (link id, system, component). Within one, stamps must rise. A new one may begin up to a minute behind our time.
    """

    def __init__(self, settings: SigningSettings, time: SigningTime, warn: Callable[[str], None]) -> None:
        self.counts: Counter[Refusal] = Counter()
        self._settings = settings
        self._time = time
        self._warn = warn
        self._streams: dict[tuple[int, int, int], int] = {}

    def admits(self, frame: bytes | bytearray, message_id: int) -> bool:
        """Whether one whole packet, whose checksum is right, is to be believed."""
        refusal = self._judge(frame, message_id)
        if refusal is None:
            return True
        if not self.counts[refusal]:
            who = f" (system {frame[_system_at(frame)]} sends them)" if refusal is Refusal.UNSIGNED else ""
            self._warn(_TOLD[refusal] + who)
        self.counts[refusal] += 1
        return False

    def _judge(self, frame: bytes | bytearray, message_id: int) -> Refusal | None:
        if not is_signed(frame):
            passes = self._settings.accept_unsigned or message_id in _UNSIGNED_AS_ON_ARDUPILOT
            return None if passes else Refusal.UNSIGNED
        if not is_signed_with(self._settings.key, frame):
            return Refusal.WRONG
        stream = frame[-_BLOCK], frame[_SYSTEM_AT], frame[_COMPONENT_AT]
        stamp = int.from_bytes(frame[-_BLOCK + 1 : -_SIGNATURE], "little")
        last = self._streams.get(stream)
        if last is None and stamp + _NEW_STREAM_UNITS < self._time.latest:
            return Refusal.STALE
        if last is None and len(self._streams) >= MAX_STREAMS:
            return Refusal.CROWDED
        if last is not None and stamp <= last:
            return Refusal.REPLAYED
        self._streams[stream] = stamp
        self._time.heard(stamp)
        return None


def _system_at(frame: bytes | bytearray) -> int:
    return _SYSTEM_AT if frame[0] == mav.PROTOCOL_MARKER_V2 else _SYSTEM_AT_V1


def is_signed(frame: bytes | bytearray) -> bool:
    """Whether a whole packet is of MAVLink 2 and says that it is signed."""
    return frame[0] == mav.PROTOCOL_MARKER_V2 and bool(frame[_FLAGS_AT] & mav.MAVLINK_IFLAG_SIGNED)


def is_signed_with(key: bytes, frame: bytes | bytearray) -> bool:
    """Whether the signature of a whole packet that says it is signed was made with a key."""
    return hmac.compare_digest(frame[-_SIGNATURE:], signature(key, frame[:-_SIGNATURE]))


def signature(key: bytes, packet: bytes | bytearray) -> bytes:
    """The six bytes that end a packet: of SHA-256 over the key and all that stands before them."""
    return hashlib.sha256(key + packet).digest()[:_SIGNATURE]
