"""Logs that were written one after another into one file: which of them are of one boot, and which boot is read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from visloc_companion.adapters.logs.recording import NS_PER_S
from visloc_companion.errors import LogError
from visloc_companion.types import Event

_APART_NS = 10 * NS_PER_S
"""No receiver's latency, and no leap second, makes so much of a difference between what two logs of one boot say of its UTC."""
Events = Sequence[tuple[int, Event]]


def logs_of(data: bytes, beginning: bytes) -> list[bytes]:
    """The logs that lie one after another in a file, each of which begins with the same bytes."""
    starts = [0]
    while (at := data.find(beginning, max(1, starts[-1] + 1))) >= 0:
        starts.append(at)
    return [data[start:end] for start, end in zip(starts, [*starts[1:], len(data)], strict=True)]


def goes_on(before: Events, after: Events, utc_before_ns: int | None, utc_after_ns: int | None) -> bool:
    """Whether a log is of the boot of the one before it in the file: its clock goes on from there, unless what both say of UTC
    at the boot's beginning (Unix minus boot time) tells that the autopilot started in between."""
    apart = None not in (utc_before_ns, utc_after_ns) and abs((utc_after_ns or 0) - (utc_before_ns or 0)) > _APART_NS
    return after[0][0] >= before[-1][0] - NS_PER_S and not apart


def chosen_boot(path: Path, boots: Sequence[Events], boot: int) -> tuple[int, tuple[str, ...]]:
    """Index of the boot that is read, `boot` from 1 or with 0 the one that tells most, and a sentence on the others.

    Raises LogError where there are not so many.
    """
    if boot > len(boots):
        raise LogError(f"holds no boot {boot} of the autopilot", where=str(path), remedy=f"name one of 1 to {len(boots)}")
    read = boot or 1 + max(range(len(boots)), key=lambda k: len(boots[k]))
    if len(boots) == 1:
        return 0, ()
    spans = ", ".join(f"{k} of {(b[-1][0] - b[0][0]) / NS_PER_S:.0f} s" for k, b in enumerate(boots, start=1))
    told = f"The log holds {len(boots)} boots of the autopilot ({spans}); read was {read}, --boot reads another."
    return read - 1, (told,)
