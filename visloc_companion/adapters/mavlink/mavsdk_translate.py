"""Between packets and the JSON in which MAVSDK's `mavlink_direct` plugin gives and takes messages.

JSON has no NaN: null stands for it, and for the infinities, which nothing in this program tells from NaN.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

from visloc_companion.adapters.mavlink.dialect import Message, mav


@dataclass(frozen=True, slots=True)
class Spoken:
    """A message by name, who says it, and its fields as JSON."""

    name: str
    system_id: int
    component_id: int
    fields_json: str


class Translator:
    """Keeps a packer and a parser of pymavlink's. Never raises for what MAVSDK gives."""

    def __init__(self) -> None:
        self._parser = mav.MAVLink(None)

    def packet(self, spoken: Spoken) -> bytes | None:
        """A MAVLink 2 packet of a message; None where our dialect lacks it or its fields do not fit."""
        try:
            fields = json.loads(spoken.fields_json)
            kind = mav.mavlink_map[fields["message_id"]]
            values = [_given(fields[name], kind.fieldtypes[i]) for i, name in enumerate(kind.fieldnames)]
            return bytes(kind(*values).pack(mav.MAVLink(None, spoken.system_id, spoken.component_id)))
        except (ValueError, TypeError, KeyError, AttributeError, ArithmeticError, mav.struct.error):
            return None

    def spoken(self, packet: bytes) -> Spoken:
        """The message in a packet of our own making."""
        message: Message = self._parser.decode(bytearray(packet))
        fields = {name: _taken(getattr(message, name)) for name in message.get_fieldnames()}
        return Spoken(
            message.get_type(), message.get_srcSystem(), message.get_srcComponent(), json.dumps(fields, allow_nan=False)
        )


def _given(value: Any, kind: str) -> Any:
    if isinstance(value, list):
        return [_given(one, kind) for one in value]
    if kind == "char":
        return str(value).encode("utf-8")
    return math.nan if value is None else value


def _taken(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_taken(one) for one in value]
    if isinstance(value, bytes):
        return value.rstrip(b"\x00").decode("ascii", errors="replace")
    return None if isinstance(value, float) and not math.isfinite(value) else value
