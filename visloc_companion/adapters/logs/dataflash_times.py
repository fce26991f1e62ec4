"""Times in a DataFlash log that the messages beside them belie: the format has no checksums.

A bit that flips in one time carries everything behind it along until the clock has caught up, for times never go back; two such,
alone but alike, would be taken for a step of the clock.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from visloc_companion.adapters.logs.dataflash_format import Fields
from visloc_companion.adapters.logs.recording import Losses

_AHEAD_US, _BACK_US, LEAP_US = 200_000, 1_000_000, 2_000_000
"""A time that is so far ahead of all before it and of the next, which goes on from those before (messages are up to 0.8 s late in
logs of 2014, and nothing more than 2 s apart is told to go on in dataflash.py), is wrong."""
_UNTIMED = frozenset(("EV", "ARM", "MSG", "CMD", "PARM", "CTUN"))
"""Messages that are taken when they come, whatever their time."""
Named = tuple[str, Fields]


def without_belied(messages: Iterable[Named], losses: Losses) -> Iterator[Named]:
    """The messages, names and fields in the order of the file, without those whose time is belied, which are counted."""
    held: tuple[Named, int] | None = None
    latest_us: int | None = None
    was_back = False
    for message in messages:
        t_us = _time_us(*message)
        if t_us is None:
            yield message
            continue
        if held is not None and latest_us is not None:
            (suspected, ahead_us), held = held, None
            if latest_us - _BACK_US <= t_us < min(ahead_us - _AHEAD_US, latest_us + LEAP_US):
                losses.dropped_messages += 1
                losses.clock_steps += 1
            else:
                yield suspected
                if ahead_us - latest_us <= LEAP_US or abs(t_us - ahead_us) <= LEAP_US:
                    latest_us = ahead_us
        if latest_us is not None and t_us - latest_us > _AHEAD_US:
            held = message, t_us
            continue
        yield message
        is_back = latest_us is not None and t_us < latest_us - _BACK_US
        if latest_us is None or (is_back and was_back):
            latest_us = t_us
        elif not is_back:
            latest_us = max(latest_us, t_us)
        was_back = is_back
    if held is not None:
        yield held[0]


def stated_time_us(fields: Fields, milliseconds: str = "TimeMS") -> Any:
    """When a message says it is of, a number if all is well. Logs of before 2015 have milliseconds, in a field of this name.
    Raises KeyError where it does not say."""
    return fields["TimeUS"] if "TimeUS" in fields else fields[milliseconds] * 1000


def _time_us(name: str, fields: Fields) -> int | None:
    """When a message says it is of; None where that does not count."""
    milliseconds = "T" if name.startswith("GPS") else "TimeMS"
    if name in _UNTIMED or not ("TimeUS" in fields or milliseconds in fields):
        return None
    value = stated_time_us(fields, milliseconds)
    return value if isinstance(value, int) else None
