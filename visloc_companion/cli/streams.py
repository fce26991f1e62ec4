"""Standard streams as a command needs them: they are there, take any name, and a disk that is full behind them is named."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import TextIOWrapper
from pathlib import Path

from visloc_companion.cli.progress import UNNAMEABLE

_DATA = 3


class _Output(TextIOWrapper):
    """Standard output that knows of a fault that it was the one to fail. What it cannot show is escaped."""

    failed = False

    def write(self, text: str, /) -> int:
        """Write, or remember that it failed."""
        try:
            return super().write(text)
        except OSError:
            self.failed = True
            raise

    def flush(self) -> None:
        """Flush, or remember that it failed."""
        try:
            super().flush()
        except OSError:
            self.failed = True
            raise


def open_streams() -> None:
    """Put the null device where a stream was closed by whoever started the command (`>&-`, some cron jobs).

    Else the next file that is opened gets its number, and what is written to standard output or error goes into it.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):  # in the order of their numbers
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode, errors=UNNAMEABLE))  # noqa: SIM115
    if isinstance(sys.stdout, TextIOWrapper) and sys.stdout is sys.__stdout__:  # which holds on to the buffer below
        sys.stdout = _Output(sys.stdout.buffer, sys.stdout.encoding, UNNAMEABLE, line_buffering=sys.stdout.line_buffering)


@contextmanager
def standard_output() -> Iterator[None]:
    """What was written meanwhile is out at the end. Where it cannot be (a full disk), one line says so and the exit code is 3.

    A reader that went away (`| head -1`) wanted no more: exit code 1, as typer has it, without words.
    """
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
    except OSError as why:
        if not (isinstance(sys.stdout, _Output) and sys.stdout.failed):
            raise
        nowhere = os.open(os.devnull, os.O_WRONLY)  # what is left is not tried again at the end of the process
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
        if isinstance(why, BrokenPipeError):
            sys.exit(1)
        sys.stderr.write(f"error: standard output: cannot be written: {why.strerror}; remedy: make room, or send it elsewhere\n")
        sys.exit(_DATA)
