"""Ctrl-C at moments at which Python drops the exception that it makes of it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from visloc_companion.cli.ctrl_c import ENDED_BY_CTRL_C, ends_at_once

PRESSED_IN_A_CALLBACK = """
import os, signal, sys, weakref
class Pressed:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            class Lock: pass
            lock = Lock()
            def released(_): os.kill(os.getpid(), signal.SIGINT)
            reference = weakref.ref(lock, released)
            del lock  # as importlib does after every module
sys.meta_path.insert(0, Pressed())
from visloc_companion.cli.start import main
main()
"""


@pytest.mark.parametrize("module", ["visloc_companion.cli.run", "visloc_companion.config", "visloc_companion.app.live"])
def test_ctrl_c_in_a_callback_of_an_import_ends_the_daemon(tmp_path: Path, module: str) -> None:
    """Without listening for it, the daemon went on to fly."""
    path = tmp_path / "visloc.toml"
    path.write_text('[link]\nurl = "udpin:127.0.0.1:0"\n')
    command = [sys.executable, "-c", PRESSED_IN_A_CALLBACK.format(module=module), "run", "--config", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (ENDED_BY_CTRL_C, "", "")


def test_whoever_listens_for_it_already_goes_on_listening() -> None:
    heard: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: heard.append(number))
    try:
        with ends_at_once():
            os.kill(os.getpid(), signal.SIGINT)
        assert heard == [signal.SIGINT]
    finally:
        signal.signal(signal.SIGINT, before)


def test_afterwards_it_is_an_exception_again() -> None:
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    with ends_at_once():
        assert signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
