"""A worker's process that is begun before the daemon knows its configuration, and imports meanwhile what every worker needs.

Python, the configuration's models and the libraries of the map take the worker as long to import as all that the daemon does
before it can begin one. This module imports nothing that takes long, for it is there before all else.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import tomllib
from collections.abc import Callable
from importlib import import_module
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

NEEDED = (
    "visloc_companion.app.localiser",
    "visloc_companion.maps.pack",
    "onnxruntime",
)
"""What takes long to import, in the order in which it is needed."""


class WorkerAhead:
    """A process that waits for its job (worker_process.WorkerJob). `take` hands it over, `close` ends one that nobody took."""

    def __init__(self) -> None:
        """Raises OSError where the system has no process for it."""
        self._connection: Connection | None
        self._process, self._connection = begun(wait_for_job)

    def take(self, job: object) -> tuple[Any, Connection] | None:
        """The process and our end of its connection, once, with the job sent; None where it is there no more."""
        connection, self._connection = self._connection, None
        if connection is None:
            return None
        try:
            connection.send(job)
        except OSError:
            self._end(connection)
            return None
        return self._process, connection

    def close(self) -> None:
        """End the process, unless it was taken."""
        connection, self._connection = self._connection, None
        if connection is not None:
            self._end(connection)

    def _end(self, connection: Connection) -> None:
        connection.close()
        self._process.kill()
        self._process.join()
        self._process.close()


def ahead_for(config: Path) -> WorkerAhead | None:
    """One for a configuration that seems to need a worker; whether it does, and what is wrong with it, others say."""
    try:
        raw = tomllib.loads(config.read_text(encoding="utf-8-sig"))
        asks = raw["map"]["pack"] and (raw.get("camera", {}).get("url") or raw.get("localiser", {}).get("terrain"))
        return WorkerAhead() if asks else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def begun(target: Callable[..., None], *args: object) -> tuple[Any, Connection]:
    """A process of `target`, given `args` and its end of a connection, and our end.

    It begins with SIGINT, SIGTERM and SIGHUP blocked, which it inherits: the daemon ends it. So does the tracker of the shared
    memory, which a terminal that goes away would end before the daemon has removed its slots. Raises OSError.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=True)
    process = context.Process(target=target, args=(*args, theirs), name="visloc-worker", daemon=True)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGHUP,))
    try:
        resource_tracker.ensure_running()  # begun by `start`, it would unblock the others before the process is there
        signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
        process.start()
    except OSError:
        ours.close()
        raise
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
    return process, ours


def wait_for_job(connection: Connection) -> None:
    """Body of the process: import, take the job, be a worker. What cannot be imported is missed where it is needed."""
    from visloc_companion.app.worker_process import limit_threads, run_worker

    limit_threads()
    from visloc_companion.localise.runtime import NO_TELEMETRY

    os.environ[NO_TELEMETRY] = "1"
    for name in NEEDED:
        with contextlib.suppress(ImportError):
            import_module(name)
    try:
        job = connection.recv()
    except (EOFError, OSError):
        return  # the daemon is gone, or needs no worker
    run_worker(job, connection)
