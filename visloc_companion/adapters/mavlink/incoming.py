"""From the bytes on the link to the messages of the one autopilot that is listened to, and to their events."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator

from visloc_companion.adapters.mavlink.codec import examine, is_autopilot
from visloc_companion.adapters.mavlink.codec_gimbal import is_of_gimbal
from visloc_companion.adapters.mavlink.dialect import AUTOPILOT_COMPONENT, Message
from visloc_companion.adapters.mavlink.framing import FrameCounts, Framer
from visloc_companion.adapters.mavlink.signing import SignatureGuard, is_signed
from visloc_companion.adapters.mavlink.unheard import Unheard
from visloc_companion.errors import Reason
from visloc_companion.types import Attitude, Event

_GARBAGE_BYTES = 64
"""So many bytes that are no message, and one more for each message, are worth a warning: ArduPilot prints some when it boots."""


class Listener:
    """Pins to one autopilot: the first HEARTBEAT of one (component 1) fixes the system id for good, or `system_id` names it.

    What another system says is passed over, but for what the systems `operators` say to us, which `ordered` is given, and what
    other components of the vehicle say, but for how its gimbals point, which `pointed` is given; a second autopilot is warned of
    once. `pinned` is 0 before any was heard, and `pin` is told; until then `expected`, a system id, is given what that system's
    autopilot says before its HEARTBEAT. With a `guard` only what it admits counts as said at all; without
    one signatures are not checked, and an autopilot that signs is warned of: it may not believe us.
    """

    def __init__(
        self,
        system_id: int,
        warn: Callable[[str], None],
        pin: Callable[[int], None],
        guard: SignatureGuard | None = None,
        operators: tuple[int, ...] = (),
        ordered: Callable[[Message], None] = lambda _message: None,
        pointed: Callable[[Message], None] = lambda _message: None,
        expected: tuple[int, Callable[[], None]] = (0, lambda: None),
    ) -> None:
        self.pinned = system_id
        self._expected, self._expected_speaks = expected
        self._operators, self._ordered, self._pointed = operators, ordered, pointed
        self._pin = pin
        self.n_heard = self.n_expected = 0
        self._unheard, self._wanted = Unheard(), system_id
        self._warn = warn
        self._framer = Framer(self._note_signature if guard is None else guard.admits)
        self._signature_told = False
        self._strangers: set[int] = set()
        self._garbage_told = False
        if system_id:
            pin(system_id)

    @property
    def counts(self) -> FrameCounts:
        """Messages, unknown messages and garbage bytes so far."""
        return self._framer.counts

    def messages(self, data: bytes) -> Iterator[Message]:
        """The autopilot's messages that are complete with these bytes, in order."""
        for msg in self._framer.feed(data):
            if not self.n_heard:
                self._note_other(msg)
            if msg.get_srcComponent() == AUTOPILOT_COMPONENT and self._is_pinned(msg):
                self.n_heard += 1
                yield msg
            elif self._is_expected(msg):
                self.n_expected += 1
                self._expected_speaks()
            elif self.pinned and msg.get_srcSystem() in self._operators:
                self._ordered(msg)
            elif self.pinned and msg.get_srcSystem() == self.pinned and is_of_gimbal(msg):
                self._pointed(msg)
        counts = self._framer.counts
        if not self._garbage_told and counts.garbage_bytes >= _GARBAGE_BYTES + counts.messages:
            self._garbage_told = True
            self._warn("bytes on the link are not MAVLink (wrong baud rate, noise, or another protocol?); they are skipped")

    def check(self, now_ns: int) -> None:
        """Warn once where no autopilot is heard; asked by the clock. What a guard refuses has a warning of its own, as have bytes
        that are no messages."""
        counts = self._framer.counts
        told = self._unheard.check(self.n_heard > 0, self._wanted, now_ns)
        if told is not None and bool(counts.messages) == bool(self._unheard.others) and counts.garbage_bytes < _GARBAGE_BYTES:
            self._warn(told)

    def _note_other(self, msg: Message) -> None:
        sender = msg.get_srcSystem(), msg.get_srcComponent()
        if sender[1] != AUTOPILOT_COMPONENT or sender[0] != (self.pinned or sender[0]):
            self._unheard.other(sender, pilot=msg.get_type() == "HEARTBEAT" and is_autopilot(msg))

    def _is_expected(self, msg: Message) -> bool:
        sender = msg.get_srcSystem(), msg.get_srcComponent()
        return not self.pinned and self._expected != 0 and sender == (self._expected, AUTOPILOT_COMPONENT)

    def _note_signature(self, frame: bytearray, _message_id: int) -> bool:
        if not self._signature_told and is_signed(frame):
            self._signature_told = True
            self._warn("messages on the link are signed, and link.signing_key_file names no key: ours may be ignored")
        return True

    def _is_pinned(self, msg: Message) -> bool:
        system_id = msg.get_srcSystem()
        pilot = msg.get_type() == "HEARTBEAT" and is_autopilot(msg)
        if pilot and self.pinned == 0 and system_id != 0:
            self.pinned = system_id
            self._pin(system_id)
        if pilot and system_id != self.pinned and system_id not in self._strangers:
            self._strangers.add(system_id)
            self._warn(f"a second autopilot (system {system_id}) is on the link and is ignored; listening to {self.pinned}")
        return bool(system_id == self.pinned and self.pinned)


class Decoder:
    """Messages to events; counts in `dropped` what is not used, by message and reason."""

    def __init__(self) -> None:
        self.dropped: Counter[tuple[str, Reason]] = Counter()
        self._attitude_boot_ns = -1

    def event(self, msg: Message, now_ns: int) -> Event | None:
        """The event of a message, None where it has none, or says a second time what was said."""
        outcome = examine(msg, now_ns)
        if isinstance(outcome, Reason):
            self.dropped[msg.get_type(), outcome] += 1
            return None
        return None if outcome is None or self._is_said_twice(outcome) else outcome

    def _is_said_twice(self, event: Event) -> bool:
        """PX4 sends each attitude as ATTITUDE and as ATTITUDE_QUATERNION; one of both is enough."""
        if not isinstance(event, Attitude):
            return False
        repeated = event.t_boot_ns == self._attitude_boot_ns
        self._attitude_boot_ns = event.t_boot_ns
        return repeated
