"""How far the commands of two runs lie apart that differ in nothing but rounding.

A sine, a product of matrices or a sum comes out otherwise in its last place with another processor, C library or NumPy.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

ROUNDING = 1e-9
"""Largest part of a number (of 1 where it is smaller) that is rounding: 5 mm of a latitude, a nanometre of a metre."""


def largest_difference(flown: Iterable[str], now: Iterable[str]) -> float | None:
    """Of the numbers of two runs' lines (`app.replay.command_lines`), as part of the larger of the two or of 1; 0 where all are
    the same bytes. None where they differ in anything else: times, kinds, texts, whole numbers. The longer's rest is left."""
    largest = 0.0
    try:
        for one, other in zip(flown, now, strict=False):
            if one != other:
                largest = max(largest, _of_lines(one, other))
    except ValueError:
        return None
    return largest


def _of_lines(one: str, other: str) -> float:
    (t_ns, command), (other_t_ns, other_command) = one.split(" ", 1), other.split(" ", 1)
    if t_ns != other_t_ns:
        raise ValueError("another time")
    return _apart(json.loads(command), json.loads(other_command))


def _apart(one: Any, other: Any) -> float:
    if type(one) is not type(other):
        raise ValueError("another kind")
    if isinstance(one, float):
        return float(abs(one - other) / max(abs(one), abs(other), 1.0))
    if isinstance(one, dict) and one.keys() == other.keys():
        return max((_apart(one[key], other[key]) for key in one), default=0.0)
    if isinstance(one, list):
        return max((_apart(*pair) for pair in zip(one, other, strict=True)), default=0.0)
    if one != other:
        raise ValueError("another value")
    return 0.0
