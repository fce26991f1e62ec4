"""What is known of another process by its number."""

from __future__ import annotations

import os
from pathlib import Path


def gone(pid: int) -> bool:
    """Whether there is none of that number any more."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def is_alive(pid: int) -> bool:
    """Whether there is one that has not ended: an ended one that nobody has waited for is not alive."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="ascii")
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"
