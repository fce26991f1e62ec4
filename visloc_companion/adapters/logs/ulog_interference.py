"""What PX4's receivers say of interference (`jamming_state`, `spoofing_state`, `authentication_state` of sensor_gps), as events.

In flight PX4 tells the same by GNSS_INTEGRITY, or in words (adapters/mavlink/codec_gnss.py).
"""

from __future__ import annotations

from collections.abc import Iterable

from visloc_companion.adapters.logs.recording import NS_PER_S
from visloc_companion.adapters.logs.ulog_format import Row
from visloc_companion.types import Event, GnssIntegrity

_AGAIN_NS = NS_PER_S
"""A state that lasts is told so often; what was told lapses after some seconds (core/satellites/gnss_receiver.py)."""
_UNKNOWN, _DETECTED = 0, 3
_INDICATED = 2
"""Of spoofing before 1.14: indicated, with 3 for indicated more than once; since then 2 is mitigated (SensorGps.msg)."""
_AUTHENTIC = {2: False, 3: True}


def interference(rows: Iterable[tuple[int, Row]], receiver: int = 0) -> list[tuple[int, Event]]:
    """Events of a receiver's (t_ns, row) in time order: at each change of what it says, and once a second while it lasts.

    Nothing of rows that do not know.
    """
    made: list[tuple[int, Event]] = []
    last: tuple[int, tuple[bool | None, ...]] | None = None
    for t_ns, row in rows:
        said = _said(row)
        if last is not None and last[1] == said and t_ns - last[0] < _AGAIN_NS:
            continue
        last = t_ns, said
        if said != (None, None, None):
            made.append((t_ns, GnssIntegrity(t_ns, receiver, *said)))
    return made


def _said(row: Row) -> tuple[bool | None, bool | None, bool | None]:
    """Whether it is jammed, spoofed, authentic; None where the receiver does not know."""
    spoofed_from = _DETECTED if "authentication_state" in row else _INDICATED
    jammed = _at_least(row.get("jamming_state", _UNKNOWN), _DETECTED)
    return (
        jammed,
        _at_least(row.get("spoofing_state", _UNKNOWN), spoofed_from),
        _AUTHENTIC.get(row.get("authentication_state", 0)),
    )


def _at_least(state: int, least: int) -> bool | None:
    return None if state == _UNKNOWN else state >= least
