"""Logs as they are handed on: compressed, and through a pipe."""

from __future__ import annotations

import gzip
import os
from pathlib import Path

import pytest

from visloc_companion.adapters.logs.open import open_log
from visloc_companion.errors import LogError


@pytest.mark.parametrize("name", ["flight.bin", "flight.tlog", "flight.ulg", "flight.ulg.gz"])
def test_a_compressed_log_is_named_as_such(tmp_path: Path, name: str) -> None:
    """It held "no ATT, GPS or POS message", or "no MAVLink packet of an autopilot"."""
    path = tmp_path / name
    path.write_bytes(gzip.compress(bytes(10_000)))
    with pytest.raises(LogError, match=rf"{name}: is compressed; remedy: zcat {name} > LOG, and"):
        open_log(path)


def test_a_log_that_comes_through_a_pipe_is_not_called_empty(tmp_path: Path) -> None:
    """`visloc replay <(zcat flight.tlog.gz)`."""
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(LogError, match=r"is a pipe, and a log is read more than once; remedy: write it into a file"):
        open_log(tmp_path / "pipe")
