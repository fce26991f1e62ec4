"""Who may have the processor: what must not be late in simulated time first, what simulated time waits for in its turn."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from contextlib import contextmanager


def go_first() -> None:
    """Let this process run whenever it has something to do, where that is allowed.

    The simulator does not wait for the daemon: one that waits for the processor of a busy machine would be late in simulated
    time. What is started from here is not affected.
    """
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(1))


@contextmanager
def in_turn() -> Iterator[None]:
    """Wait for the processor as others do, for work that may take long."""
    policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    try:
        yield
    finally:
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, policy, parameter)
