"""The conversation with one autopilot, without any I/O: bytes in, events and bytes out, time as an argument.

A shell calls `receive` with what arrived and `poll` about every 50 ms, and after each call sends `packets()`. Nothing here raises
for what comes over the link. What comes in: incoming.py; positions: outgoing.py; what is asked by the clock: upkeep.py.
"""

from __future__ import annotations

from collections import Counter, deque

from visloc_companion.adapters.mavlink import operator_position
from visloc_companion.adapters.mavlink.companion_status import computer_status, named_values
from visloc_companion.adapters.mavlink.dialect import Message
from visloc_companion.adapters.mavlink.framing import FrameCounts
from visloc_companion.adapters.mavlink.incoming import Decoder, Listener
from visloc_companion.adapters.mavlink.origin_check import OriginCheck
from visloc_companion.adapters.mavlink.outbox import Outbox
from visloc_companion.adapters.mavlink.outgoing import PositionSender
from visloc_companion.adapters.mavlink.outputs.choice import Choice
from visloc_companion.adapters.mavlink.presence import Presence
from visloc_companion.adapters.mavlink.settings import CompanionState, SessionSettings
from visloc_companion.adapters.mavlink.signing import Refusal, SignatureGuard, SigningTime
from visloc_companion.adapters.mavlink.streams import StreamState
from visloc_companion.adapters.mavlink.texts import BURST, TextSender
from visloc_companion.adapters.mavlink.two_senders import REMEDY, TwoSenders
from visloc_companion.adapters.mavlink.upkeep import Upkeep
from visloc_companion.errors import Reason
from visloc_companion.types import (
    EkfSource,
    EstimatorStatus,
    Event,
    GeoPoint,
    Injection,
    LinkChanged,
    Notice,
    OriginChanged,
    Report,
    RequestMessage,
    Severity,
    SourceSwitched,
    SwitchSource,
)

_MAX_WARNINGS = 50
_ANSWERS = ("COMMAND_ACK", "PARAM_VALUE")
"""After which the next question need not wait for the next `poll`."""


class MavlinkSession:
    """Pins to one autopilot, keeps its streams, answers its clock, carries injections and switches.

    `poll` at least twice a second: a longer pause is taken for a stall of our own and not held against the autopilot.

    Which autopilot is listened to: incoming.Listener. Time that goes backwards is held at its latest.
    """

    def __init__(self, settings: SessionSettings) -> None:
        self.settings = settings
        self._warnings: deque[str] = deque(maxlen=_MAX_WARNINGS)
        signing = settings.signing
        self._time = None if signing is None else SigningTime(signing.stamp_at_zero, signing.keep)
        self._guard = None if signing is None or self._time is None else SignatureGuard(signing, self._time, self._warn)
        self._outbox = Outbox(settings.component_id, signing, self._time)
        self._listener = Listener(
            settings.system_id,
            self._warn,
            self._outbox.speak_as,
            self._guard,
            settings.operator_systems,
            self._take_order,
            self._take_pointed,
            (settings.left_system_id, self._expected_speaks),
        )
        if settings.left_system_id and not settings.system_id:
            self._outbox.speak_as(settings.left_system_id)
        self._decoder = Decoder()
        self._presence, self._origin_check = Presence(settings.timeout_s), OriginCheck()
        self._two = TwoSenders()
        self._upkeep = Upkeep(settings, self._outbox)
        self._sender = PositionSender(settings, self._outbox, self._warn, self._say)
        self._texts = TextSender()
        self._told: deque[tuple[int, Notice]] = deque(maxlen=BURST)
        self._heard_ns = -1
        self._state: CompanionState | None = None
        self._pending: list[Event] = []
        self._forbidden_told = self._ask_on = False
        self._now_ns = 0

    # ------------------------------------------------------------------------------------------------------------ what is known

    @property
    def link(self) -> LinkChanged:
        """The autopilot as far as it is known; `up` tells whether it is heard."""
        return self._presence.link

    @property
    def origin(self) -> GeoPoint | None:
        """The autopilot's EKF origin, None while it is not known (then nothing is injected)."""
        return self._presence.origin

    @property
    def n_heard(self) -> int:
        """How many messages the autopilot has sent so far."""
        return self._listener.n_heard

    @property
    def n_vouched(self) -> int:
        """The same and what one says that is expected, before its HEARTBEAT; with signing, what a holder of the key said with an
        old time, too: such a one may learn the time from us."""
        return self.n_heard + self._listener.n_expected + self.unbelieved[Refusal.STALE]

    @property
    def counts(self) -> FrameCounts:
        """Messages, unknown messages and garbage bytes so far."""
        return self._listener.counts

    @property
    def dropped(self) -> Counter[tuple[str, Reason]]:
        """How many messages were not used, by message and reason."""
        return self._decoder.dropped

    @property
    def refused(self) -> Counter[Reason]:
        """How many injections were not sent, by reason."""
        return self._sender.refusals.counts

    @property
    def withheld(self) -> str:
        """Why the positions of now are not sent, in a few words; empty where they are."""
        return self._sender.withheld

    @property
    def n_sent(self) -> int:
        """How many positions were queued to be sent so far."""
        return self._sender.n_sent

    @property
    def unbelieved(self) -> Counter[Refusal]:
        """How many packets were refused for want of a right signature, by reason."""
        return Counter() if self._guard is None else self._guard.counts

    @property
    def forbidden(self) -> int:
        """How many messages were held back because the daemon must never send them (allow_list.py): each one a fault."""
        return self._outbox.forbidden

    @property
    def choice(self) -> Choice:
        """Which message carries positions to this autopilot, and why; or why none does."""
        return self._sender.choice

    def stream_state(self, message_id: int) -> StreamState:
        """Whether a requested message arrives at about the rate that was asked for."""
        return self._upkeep.streams.state(message_id)

    def warnings(self) -> list[str]:
        """What the operator may want to know since the last call; forgotten by the call."""
        self._warnings.extend(self._upkeep.streams.warnings)
        self._upkeep.streams.warnings.clear()
        if self._outbox.forbidden and not self._forbidden_told:
            self._forbidden_told = True
            self._warn(f"held back, for it must never be sent: {self._outbox.objection}; please report it")
        drained = list(self._warnings)
        self._warnings.clear()
        return drained

    # ------------------------------------------------------------------------------------------------------------ in

    def receive(self, data: bytes, now_ns: int) -> list[Event]:
        """Take bytes from the link; the events in them, stamped `now_ns`. Any bytes, in any pieces."""
        now_ns = self._advance(now_ns)
        for msg in self._listener.messages(data):
            self._presence.heard(now_ns)
            self._take(msg, now_ns)
        if self._ask_on and self.link.up:
            self._ask(now_ns)
        return self._drain_events()

    def poll(self, now_ns: int) -> list[Event]:
        """What time brings: heartbeat, own TIMESYNC requests, requests that are due, the silence of the autopilot."""
        now_ns = self._advance(now_ns)
        if self._presence.silent(now_ns):
            self._lose(f"the autopilot is silent for {self.settings.timeout_s:g} s", now_ns)
        self._listener.check(now_ns)
        flowing = CompanionState.ACTIVE if self._sender.active(now_ns) else CompanionState.STANDBY
        self._upkeep.heartbeat(self._state or flowing, now_ns)
        if self.link.up:
            self._ask(now_ns)
        return self._drain_events()

    # ------------------------------------------------------------------------------------------------------------ out

    def packets(self) -> list[bytes]:
        """The packets to be sent now, oldest first; forgotten by the call."""
        return self._outbox.drain()

    def outgoing(self) -> bytes:
        """The same as one string of bytes."""
        return b"".join(self._outbox.drain())

    def send(self, injection: Injection, now_ns: int) -> bool:
        """Queue the position; False, with a count and one warning a reason, where it must not be sent, or not so soon."""
        origin = None if self._origin_check.doubted else self.origin
        return self._sender.send(injection, self.link, origin, self._advance(now_ns))

    def disconnected(self, why: str, now_ns: int) -> list[Event]:
        """The connection is gone: the link is down at once, not after its silence."""
        now_ns = self._advance(now_ns)
        self._lose(why, now_ns) if self.link.up else self._warn(why)
        return self._drain_events()

    def request(self, message: RequestMessage, now_ns: int) -> None:
        """Keep a message coming at a rate (0 Hz: once). `stream_state` tells how it goes."""
        self._upkeep.streams.want(message, self._advance(now_ns))

    def switch(self, source: SwitchSource, now_ns: int) -> None:
        """Switch the position source; the end comes as a SourceSwitched event. Not to vision where no position can be sent."""
        why_nothing = self._sender.why_nothing
        if source.source is EkfSource.VISION and why_nothing:
            self._pending.append(SourceSwitched(self._advance(now_ns), source.source, False, why_nothing))
            return
        shows_use = self._sender.shows_use(source.source)
        self._pending += self._upkeep.switcher.start(source.source, self.link, self._advance(now_ns), shows_use=shows_use)

    def notify(self, notice: Notice, now_ns: int) -> None:
        """Queue a STATUSTEXT (several of a long text) where the notice is for the operator, unless it repeats or floods.

        What the autopilot may not have heard, the last few texts before it is heard (again), is said then.
        """
        now_ns = self._advance(now_ns)
        if notice.to_operator:
            self._told.append((now_ns, notice))
            if self._listener.pinned:
                self._say(notice)

    def report(self, report: Report, now_ns: int) -> None:
        """Queue what ground stations are told of the companion; the heartbeat shows CRITICAL where the report says so."""
        self._advance(now_ns)
        self.set_state(CompanionState.CRITICAL if report.critical else None)
        if not self._listener.pinned:
            return
        for message in named_values(report):
            self._outbox.put(message)
        if report.load is not None:
            self._outbox.put(computer_status(report.load, report.t_ns))

    def set_state(self, state: CompanionState | None) -> None:
        """The state that the heartbeat shows; None (as at first) shows ACTIVE while injections flow and else STANDBY."""
        self._state = state

    # ------------------------------------------------------------------------------------------------------------ inside

    def _advance(self, now_ns: int) -> int:
        self._now_ns = max(self._now_ns, now_ns)
        if self._time is not None:
            self._time.advance(self._now_ns)
        return self._now_ns

    def _drain_events(self) -> list[Event]:
        events, self._pending = self._pending, []
        return events

    def _say(self, notice: Notice) -> None:
        for message in self._texts.messages(notice, self._now_ns):
            self._outbox.put(message)

    def _warn(self, text: str) -> None:
        self._warnings.append(text)

    def _ask(self, now_ns: int) -> None:
        self._ask_on = False
        self._sender.poll(self.link, now_ns)
        sure = not self._origin_check.doubted
        self._pending += self._upkeep.ask_what_is_due(self.link, self.origin is not None, now_ns, sure_of_origin=sure)

    def _expected_speaks(self) -> None:
        self._upkeep.ask_for_heartbeat(self.settings.left_system_id, self._now_ns)

    def _take(self, msg: Message, now_ns: int) -> None:
        if self._two.there(now_ns):
            said = self._decoder.event(msg, now_ns)
            if said is not None:
                self._two.in_turn(said, now_ns)
                if self._presence.restarted(said):
                    self._two.went_back(now_ns)
            return
        if not self.link.up and msg.get_type() != "HEARTBEAT":
            self._upkeep.ask_for_heartbeat(self._listener.pinned, now_ns)
            return
        self._ask_on |= msg.get_type() in _ANSWERS
        self._upkeep.streams.arrived(msg.get_msgId())
        if self._sender.hear(msg, now_ns):
            return
        events = self._upkeep.take(msg, self._listener.pinned, now_ns)
        if events is not None:
            for event in events:
                self._pass_on(event, now_ns)
            return
        decoded = self._decoder.event(msg, now_ns)
        if isinstance(decoded, OriginChanged):
            self._origin_check.told()
        if isinstance(decoded, LinkChanged):
            self._take_link(decoded, now_ns)
        elif decoded is not None and (not isinstance(decoded, OriginChanged) or self._presence.take_origin(decoded)):
            self._pass_on(decoded, now_ns)

    def _pass_on(self, event: Event, now_ns: int) -> None:
        if self._two.in_turn(event, now_ns):
            self._lose(self._of_two(), now_ns)
            return
        if self._presence.restarted(event):
            two = self._two.went_back(now_ns)
            self._lose(self._of_two() if two else "the autopilot's clock went back: it was restarted", now_ns)
            if two:
                return
        if isinstance(event, EstimatorStatus):
            self._upkeep.streams.has_position = event.horizontal_position_ok
        if self._origin_check.hear(event, self.link.autopilot, self.origin):
            self._ask_on = True
            self._upkeep.doubt_origin(now_ns)
        self._pending.append(event)

    def _of_two(self) -> str:
        """Tell the operator of two autopilots with one number; why that ends the link."""
        number = self._listener.pinned
        self._say(Notice(Severity.CRITICAL, f"visloc: 2 autopilots with system id {number}, unused", to_operator=True))
        return f"two autopilots with system id {number} are on the link, and nothing is taken of either: {REMEDY}"

    def _take_order(self, msg: Message) -> None:
        """A ground station speaks to this component."""
        if not operator_position.is_for(msg, self._listener.pinned, self.settings.component_id):
            return
        answer, said = operator_position.taken(msg, self.origin is not None, self._now_ns)
        self._outbox.put(answer)
        if said is not None:
            self._texts.asked()
            self._pending.append(said)

    def _take_pointed(self, msg: Message) -> None:
        """A gimbal speaks for itself: no sign that the autopilot lives, nor an answer to what was asked of it."""
        pointed = self._decoder.event(msg, self._now_ns) if self.link.up else None
        if pointed is not None:
            self._pending.append(pointed)

    def _take_link(self, event: LinkChanged, now_ns: int) -> None:
        changed, came = self._presence.take_link(event)
        if changed is not None:
            self._pending.append(changed)
        if came:
            self._ask_on = True
            self._upkeep.restart(now_ns)
            self._sender.restart(self.link)
            self._say_again()

    def _say_again(self) -> None:
        """What was said since the autopilot was last heard."""
        unheard = [notice for t_ns, notice in self._told if t_ns > self._heard_ns]
        self._told.clear()
        for notice in unheard:
            self._texts.asked()
            self._say(notice)

    def _lose(self, why: str, now_ns: int) -> None:
        changed = self._presence.down(now_ns)
        self._origin_check.forget()
        if changed is not None:
            self._heard_ns = self._presence.heard_ns
            self._warn(why)
            self._pending.append(changed)
        self._pending += self._upkeep.forget(why, now_ns)
