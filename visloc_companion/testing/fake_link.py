"""An AutopilotLink without an autopilot: a test feeds events and reads what was sent."""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import dataclass, field

from visloc_companion.app.mailbox import Mailbox
from visloc_companion.protocols import Clock
from visloc_companion.types import (
    AutopilotKind,
    EkfSource,
    Event,
    GeoPoint,
    Injection,
    LinkChanged,
    Notice,
    OriginChanged,
    Report,
    RequestMessage,
    SourceSwitched,
    SwitchSource,
)

_CAPACITY = 10_000
_ROUND_NS = 50_000_000


@dataclass(slots=True)
class FakeLink:
    """Behaves as the contract suite wants (testing/contract_link.py).

    It comes up with the first call, with its origin where it has one. `feed` adds any event. `grants_streams` and
    `grants_switches` decide the answers. What was sent stays in the lists; an injection without origin or link is not sent.
    While it `hangs` nobody sees to it, and positions that are `withheld` go nowhere. `left_out` is what a test says.
    """

    clock: Clock
    kind: AutopilotKind = AutopilotKind.ARDUPILOT
    system_id: int = 1
    version: str = "4.6.3"
    origin: GeoPoint | None = None
    grants_streams: bool = True
    grants_switches: bool = True
    source: EkfSource = EkfSource.GNSS
    injections: list[Injection] = field(default_factory=list)
    requests: list[RequestMessage] = field(default_factory=list)
    notices: list[Notice] = field(default_factory=list)
    reports: list[Report] = field(default_factory=list)
    closed: bool = False
    hangs: bool = False
    withheld: str = ""
    left_out: int = 0
    up: bool = False
    armed: bool = False
    _begun: bool = False
    _events: Mailbox[Event | None] = field(default_factory=lambda: Mailbox(_CAPACITY, newest_wins=True))

    @property
    def rounds(self) -> int:
        """Twenty a second by the clock."""
        return 0 if self.hangs else self.clock.now_ns() // _ROUND_NS

    @property
    def n_sent(self) -> int:
        """All that it noted."""
        return len(self.injections)

    def feed(self, *events: Event) -> None:
        """Let the autopilot say something."""
        for event in events:
            self._events.put(event)

    def set_up(self, up: bool) -> None:
        """The autopilot is heard, or falls silent."""
        self.up = up
        self.feed(LinkChanged(self.clock.now_ns(), up, self.kind, self.version, self.system_id, self.armed))
        if up and self.origin is not None:
            self.set_origin(self.origin)

    def set_origin(self, origin: GeoPoint) -> None:
        """The autopilot's estimator gets (another) origin."""
        self.origin = origin
        self.feed(OriginChanged(self.clock.now_ns(), origin))

    def events(self) -> AsyncIterator[Event]:
        """Events that were fed, until `close`."""
        self._begin()
        return self._iterate()

    async def send(self, injection: Injection) -> None:
        """Note an injection."""
        if self._begin() and self.up and self.origin is not None and not self.withheld:
            self.injections.append(injection)

    async def request(self, message: RequestMessage) -> bool:
        """Note a request; what `grants_streams` says."""
        if not self._begin():
            return False
        self.requests.append(message)
        return self.grants_streams

    async def switch(self, source: SwitchSource) -> bool:
        """Switch where `grants_switches`; the event says so too."""
        if not self._begin():
            return False
        accepted = self.up and self.grants_switches
        if accepted:
            self.source = source.source
        self.feed(SourceSwitched(self.clock.now_ns(), source.source, accepted, "" if accepted else "refused"))
        return accepted

    async def notify(self, notice: Notice) -> None:
        """Note a notice for the operator."""
        if self._begin() and notice.to_operator:
            self.notices.append(notice)

    async def report(self, report: Report) -> None:
        """Note a report."""
        if self._begin():
            self.reports.append(report)

    async def close(self) -> None:
        """End `events`; nothing is sent any more."""
        if not self.closed:
            self.closed = True
            self._events.put(None)

    def _begin(self) -> bool:
        if not self._begun and not self.closed:
            self._begun = True
            self.set_up(True)
        return not self.closed

    async def _iterate(self) -> AsyncIterator[Event]:
        while (event := await self._events.get()) is not None:
            yield event
