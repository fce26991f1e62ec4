"""Whether a fault says something: one that ends before it begins would leave a flight without any, which then passes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

from visloc_companion.errors import ConfigError

ENDS = ("end_s", "release_s")
"""Times that may be infinite: the fault stays."""
NOT_NEGATIVE = ("ramp_s", "delay_s", "spread_s", "focus_px", "exposure_s", "light")
POSITIVE = ("visibility_m", "max_gain", "restart_s")
LEAST_SHARE = -1.0
"""Of a focal length's error: what is left is more than nothing."""


def require_sound(fault: Any) -> None:
    """Raises ConfigError naming the fault, its field and the remedy where a fault cannot happen as it is stated."""
    values = {field.name: getattr(fault, field.name) for field in fields(fault)}
    for name, remedy in _problems(values):
        raise ConfigError(f"{name} is {values[name]}", where=type(fault).__name__, remedy=remedy)


def _problems(values: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Fields that cannot be, each with what would do."""
    for name, value in values.items():
        numbers = value if isinstance(value, tuple) else (value,)
        if any(math.isnan(n) or (math.isinf(n) and (name not in ENDS or n < 0)) for n in numbers):
            yield name, "give a finite number"
    for name in NOT_NEGATIVE:
        if values.get(name, 0.0) < 0:
            yield name, "give a number from 0 on"
    for name in POSITIVE:
        if values.get(name, 1.0) <= 0:
            yield name, "give a number above 0"
    if values.get("share", 0.0) <= LEAST_SHARE:
        yield "share", "give a number above -1"
    for name in ENDS:
        if name in values and values[name] <= values["start_s"]:
            yield name, f"let it end after its start, {values['start_s']:g} s"
