"""A configuration as TOML: tables of plain values, which is all that a configuration has (the standard library only reads)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any


def to_toml(data: Mapping[str, Any]) -> str:
    """TOML of a mapping of plain values and of tables of plain values, ready for `visloc run --config`."""
    top = [f"{name} = {_value(value)}" for name, value in data.items() if not isinstance(value, Mapping)]
    blocks = ["\n".join(top)] if top else []
    for name, table in data.items():
        if isinstance(table, Mapping):
            blocks.append("\n".join([f"[{name}]", *(f"{key} = {_value(value)}" for key, value in table.items())]))
    return "\n\n".join(blocks) + "\n"


def _value(value: Any) -> str:
    """A JSON string, number, boolean or array of them is one of TOML too, but for DEL, which TOML wants escaped."""
    return json.dumps(value, ensure_ascii=True, allow_nan=False).replace("\x7f", "\\u007f")
