"""A handful of the autopilot's parameters, read one by one: PARAM_REQUEST_READ (20) and PARAM_VALUE (22). Sans-IO.

An autopilot says nothing of a parameter that it does not have, so what is not answered after `TRIES` counts as missing. It is
asked for now and then all the same: question or answer may have been lost, too.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

from visloc_companion.adapters.mavlink.dialect import AUTOPILOT_COMPONENT, Message, mav
from visloc_companion.adapters.mavlink.encode import parameter_value
from visloc_companion.types import AutopilotKind

AT_ONCE = 4
"""ArduPilot queues no more than five requests."""
TIMEOUT_NS, TRIES = 400_000_000, 3
AGAIN_NS = 5_000_000_000
_NAME_LENGTH = 16


class ParameterReader:
    """Asks for names, `AT_ONCE` at a time, and keeps the values, which are up to date with every PARAM_VALUE that comes."""

    def __init__(self) -> None:
        self.values: dict[str, float] = {}
        self._kind = AutopilotKind.UNKNOWN
        self._wanted: frozenset[str] = frozenset()
        self._waiting: deque[tuple[str, int]] = deque()
        self._asked: dict[str, tuple[int, int]] = {}
        self._missing: deque[str] = deque()
        self._again_ns = 0

    @property
    def complete(self) -> bool:
        """Whether every name was answered or given up."""
        return not self._waiting and not self._asked

    def start(self, kind: AutopilotKind, names: Iterable[str]) -> None:
        """Read these names of an autopilot (again). What is known of one of another kind is forgotten, else it holds until it is
        answered anew: a link that was just lost may soon lose answers, too."""
        if kind is not self._kind:
            self.values.clear()
        self._kind, self._wanted = kind, frozenset(names)
        self._asked.clear()
        self._missing.clear()
        self._waiting = deque((name, 0) for name in names)

    def take(self, msg: Message) -> bool:
        """Take a PARAM_VALUE; True where it says something new. A value that is no number is no answer."""
        name = msg.param_id.rstrip("\x00")
        value = parameter_value(msg, self._kind)
        if name not in self._wanted or not math.isfinite(value):
            return False
        self._asked.pop(name, None)
        self._waiting = deque(entry for entry in self._waiting if entry[0] != name)
        self._missing = deque(other for other in self._missing if other != name)
        new = self.values.get(name) != value
        self.values[name] = value
        return new

    def poll(self, system_id: int, now_ns: int) -> list[Message]:
        """The requests to send now."""
        for name, (tries, sent_ns) in list(self._asked.items()):
            if now_ns - sent_ns >= TIMEOUT_NS:
                del self._asked[name]
                if tries < TRIES:
                    self._waiting.append((name, tries))
                else:
                    self._missing.append(name)
                    self._again_ns = now_ns + AGAIN_NS
        requests = []
        while self._waiting and len(self._asked) < AT_ONCE:
            name, tries = self._waiting.popleft()
            self._asked[name] = (tries + 1, now_ns)
            requests.append(_request(system_id, name))
        return requests or self._ask_again(system_id, now_ns)

    def _ask_again(self, system_id: int, now_ns: int) -> list[Message]:
        if not self.complete or now_ns < self._again_ns:
            return []
        self._again_ns = now_ns + AGAIN_NS
        names = list(self._missing)[:AT_ONCE]
        self._missing.rotate(-len(names))
        return [_request(system_id, name) for name in names]


def _request(system_id: int, name: str) -> Message:
    return mav.MAVLink_param_request_read_message(system_id, AUTOPILOT_COMPONENT, name.encode("ascii")[:_NAME_LENGTH], -1)
