"""A MAVLink session and a fake autopilot joined without I/O, in a time that runs as fast as it is computed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.testing.fake_autopilot import FakeAutopilot
from visloc_companion.types import Event

_STEP_NS = 10_000_000
_POLL_EVERY = 5


@dataclass(slots=True)
class Conversation:
    """`now_ns` is our clock; the autopilot's boot clock is behind it by `boot_offset_ns`. Each way takes one step of 10 ms."""

    session: MavlinkSession
    autopilot: FakeAutopilot = field(default_factory=FakeAutopilot)
    now_ns: int = 1_000_000_000_000
    boot_offset_ns: int = 997_000_000_000
    events: list[Event] = field(default_factory=list)
    _n: int = 0

    def run(self, seconds: float, *, until: Callable[[], bool] | None = None) -> list[Event]:
        """Let time pass, at most until something is true; the events of this stretch."""
        first = len(self.events)
        for _ in range(round(seconds * 1e9) // _STEP_NS):
            if until is not None and until():
                break
            self._step()
        return self.events[first:]

    def _step(self) -> None:
        self._n += 1
        self.now_ns += _STEP_NS
        if self._n % _POLL_EVERY == 0:
            self.events += self.session.poll(self.now_ns)
        self.autopilot.receive(self.session.outgoing())
        self.autopilot.step(self.now_ns - self.boot_offset_ns)
        self.events += self.session.receive(self.autopilot.outgoing(), self.now_ns)
        self.autopilot.receive(self.session.outgoing())
