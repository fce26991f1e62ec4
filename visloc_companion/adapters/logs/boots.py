"""Logs that were written one after another into one file: which of them are of one boot, and which boot is read."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Protocol, TypeVar

from visloc_companion.adapters.logs.recording import NS_PER_S, LogBytes
from visloc_companion.errors import LogError
from visloc_companion.types import Event

_APART_NS = 10 * NS_PER_S
"""No receiver's latency, and no leap second, makes so much of a difference between what two logs of one boot say of its UTC."""


class Boot(Protocol):
    """What a log, or all logs of one boot, tell."""

    @property
    def events(self) -> Sequence[tuple[int, Event]]:
        """In time order."""

    @property
    def unix_minus_boot_ns(self) -> int | None:
        """UTC at the boot's beginning (Unix minus boot time), where they say so."""


OfBoot = TypeVar("OfBoot", bound=Boot)


def logs_of(data: LogBytes, beginning: bytes) -> list[tuple[int, int]]:
    """Where the logs begin and end that lie one after another in a file, each of which begins with the same bytes."""
    starts = [0]
    while (at := data.find(beginning, max(1, starts[-1] + 1))) >= 0:
        starts.append(at)
    return list(zip(starts, [*starts[1:], len(data)], strict=True))


def put_together(logs: Iterable[OfBoot], join: Callable[[OfBoot, OfBoot], None]) -> list[OfBoot]:
    """The boots that the logs of a file, in its order, are of; `join` adds a log to the boot that it goes on. One without events
    is passed over."""
    boots: list[OfBoot] = []
    for log in logs:
        if not log.events:
            continue
        if boots and _goes_on(boots[-1], log):
            join(boots[-1], log)
        else:
            boots.append(log)
    return boots


def _goes_on(before: Boot, after: Boot) -> bool:
    """Whether a log is of the boot of the one before it in the file: its clock goes on from there, unless what both say of UTC
    tells that the autopilot started in between."""
    one_ns, other_ns = before.unix_minus_boot_ns, after.unix_minus_boot_ns
    if one_ns is not None and other_ns is not None and abs(other_ns - one_ns) > _APART_NS:
        return False
    return after.events[0][0] >= before.events[-1][0] - NS_PER_S


def chosen_boot(path: Path, boots: Sequence[Boot], boot: int) -> tuple[int, tuple[str, ...]]:
    """Index of the boot that is read, `boot` from 1 or with 0 the one that tells most, and a sentence on the others.

    Raises LogError where there are not so many.
    """
    if boot > len(boots):
        raise LogError(f"holds no boot {boot} of the autopilot", where=str(path), remedy=f"name one of 1 to {len(boots)}")
    read = boot or 1 + max(range(len(boots)), key=lambda k: len(boots[k].events))
    if len(boots) == 1:
        return 0, ()
    spans = ", ".join(f"{k} of {(b.events[-1][0] - b.events[0][0]) / NS_PER_S:.0f} s" for k, b in enumerate(boots, start=1))
    told = f"The log holds {len(boots)} boots of the autopilot ({spans}); read was {read}, --boot reads another."
    return read - 1, (told,)
