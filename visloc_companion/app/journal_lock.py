"""Tells a journal that is being written from one whose writer was killed: who writes holds a lock on the file.

The system lets it go with the process, however that ends, so no lock is left behind. It holds nobody up who does not ask for it
(flock). A file system that has none leaves a journal that is being written looking like one that was cut.
"""

from __future__ import annotations

import contextlib
import fcntl
from typing import BinaryIO


def hold(stream: BinaryIO) -> None:
    """Say that a file is being written, until it is closed; in vain where the file system knows no locks."""
    with contextlib.suppress(OSError, ValueError):  # io.UnsupportedOperation of a stream without a file is both
        fcntl.flock(stream.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)


def is_held(stream: BinaryIO) -> bool:
    """Whether somebody writes a file that is open for reading here. Who asks at the same time is not taken for a writer."""
    try:
        fcntl.flock(stream.fileno(), fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    fcntl.flock(stream.fileno(), fcntl.LOCK_UN)
    return False
