"""What is read or replayed in one go and stays to the end is no garbage: nobody need look for any in it."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def read_once() -> Iterator[None]:
    """While a flight is read or goes through the navigator, Python looks for no cycles of garbage, and in what is there then
    never again: it would go through all of that each time it has grown by a quarter, and a flight has a million objects and no
    cycle."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
