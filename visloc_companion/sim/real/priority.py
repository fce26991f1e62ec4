"""Who may have the processor: what must not be late in simulated time first, what simulated time waits for in its turn."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from contextlib import contextmanager


def go_first(pid: int = 0) -> None:
    """Let a process (0: this one) run whenever it has something to do, where that is allowed.

    The simulator does not wait for the daemon: one that waits for the processor of a busy machine would be late in simulated
    time. Nor does its physics wait for its link: on a busy machine PX4 read positions up to 1.2 s of simulated time after they
    had come. What this process starts is not affected; what another one starts is.
    """
    policy = os.SCHED_RR if pid else os.SCHED_RR | os.SCHED_RESET_ON_FORK
    with contextlib.suppress(PermissionError, ProcessLookupError):
        os.sched_setscheduler(pid, policy, os.sched_param(1))


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
