"""A few things kept by number, until their answer comes or newer ones take their place."""

from __future__ import annotations

from typing import TypeVar

REQUESTS_KEPT = 8
_T = TypeVar("_T")


def remember(kept: dict[int, _T], number: int, thing: _T, most: int = REQUESTS_KEPT) -> None:
    """Keep a thing under a number; of more than `most` the one that was kept first goes."""
    kept[number] = thing
    if len(kept) > most:
        del kept[next(iter(kept))]
