"""A process that was started for a piece of work ends with the one that waits for it."""

from __future__ import annotations

import ctypes
import os
import signal
import threading
from collections.abc import Callable
from multiprocessing import parent_process
from multiprocessing.connection import wait

_PR_SET_PDEATHSIG = 1
_libc = ctypes.CDLL(None)


def end_with_parent(first: Callable[[], None] | None = None) -> None:
    """End this process as soon as the one that started it is gone, killed ones too, which cannot say so.

    First thing in a process of a pool: it would go on to the end of its work, and then wait for more for ever. Nothing is
    unwound: what the process has started itself must end by itself, or be ended by `first`. Nothing is done in a process that has
    no such parent.
    """
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_watch, args=(parent.sentinel, first), name="with-parent", daemon=True).start()


def end_with_starter() -> None:
    """A `preexec_fn` of subprocess.Popen: SIGKILL to the new program when the thread that starts it ends (prctl(2)).

    One system call, which takes no lock of a process that has other threads. What the program starts itself is not meant.
    """
    _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def _watch(sentinel: int, first: Callable[[], None] | None) -> None:
    wait([sentinel])
    try:
        if first is not None:
            first()
    finally:
        os._exit(1)
