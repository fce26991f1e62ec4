"""Ctrl-C while a command is still being loaded.

Python turns it into an exception wherever it happens to be. Imports run callbacks whose exceptions are printed and dropped
(importlib's locks, weakref): the command would go on as if nothing had been pressed.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

ENDED_BY_CTRL_C = 130
"""As the commands themselves end then: 128 + SIGINT."""


@contextmanager
def ends_at_once() -> Iterator[None]:
    """Ctrl-C ends the process on the spot, with `ENDED_BY_CTRL_C` and without a word, unless somebody else listens for it or it
    is ignored. For what leaves nothing behind: no result is begun, and processes that were end with their pipe."""
    ours = threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if ours:
        signal.signal(signal.SIGINT, _end)
    try:
        yield
    finally:
        if ours and signal.getsignal(signal.SIGINT) is _end:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def _end(_number: int, _frame: FrameType | None) -> None:
    os._exit(ENDED_BY_CTRL_C)
