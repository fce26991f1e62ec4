"""A flight whose processes are disturbed: what is done to them, and what the flight must not show."""

from __future__ import annotations

import random
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.disturbed import beyond, figures, flown, held
from benchmarks.flown import disturbances
from benchmarks.flown.disturbances import KINDS, Disturber, Taken
from visloc_companion.errors import ConfigError
from visloc_companion.types import AutopilotKind

SPAWNING = """
import multiprocessing, os, time
def work():
    print(os.getpid(), flush=True)  # it is the worker only once its own program runs
    time.sleep(60)
if __name__ == "__main__":
    child = multiprocessing.get_context("spawn").Process(target=work, daemon=True)
    child.start()
    child.join()
    print(child.exitcode, flush=True)
"""


@contextmanager
def running(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen([sys.executable, *arguments], stdout=subprocess.PIPE) as process:
        try:
            yield process
        finally:
            process.kill()


def record(error_m: list[float], injected: list[bool], t_s: list[float]) -> Any:
    sent = np.array(injected)
    level = np.full(len(error_m), 4.0)
    times = np.array(t_s)[sent]
    return SimpleNamespace(error_m=np.array(error_m), protection_level_m=level, injected=sent, injection_t_s=times)


def disturber(files: tuple[int, int] = (16, 16), longest_stop_s: float = 0.0) -> Disturber:
    made = Disturber(1, [])
    made.daemon = made.worker = [Taken(20.0, 170.0, files[0]), Taken(25.0, 175.0, files[1])]
    made.done, made.longest_stop_s = ["noise", "noise", "clients"], longest_stop_s
    return made


def test_a_position_beyond_its_level_is_counted_where_it_was_sent() -> None:
    times = [0.0, 0.1, 0.2]
    assert held(record([1.0, 3.9, 2.0], [True] * 3, times), disturber())
    wrong = record([1.0, 4.1, 2.0], [True] * 3, times)
    assert beyond(wrong) == 1
    assert not held(wrong, disturber())
    assert held(record([1.0, 4.1, 2.0], [True, False, True], times), disturber())


def test_silence_is_measured_against_how_long_the_daemon_was_stopped() -> None:
    silent = record([1.0, 1.0], [True] * 2, [0.0, 3.0])
    assert not held(silent, disturber(longest_stop_s=1.9))
    assert held(silent, disturber(longest_stop_s=2.1))


def test_files_that_are_left_open_are_told() -> None:
    quiet = record([1.0, 1.0], [True] * 2, [0.0, 0.1])
    assert not held(quiet, disturber(files=(16, 17)))
    text = "\n".join(figures(quiet, disturber(files=(16, 17))))
    assert "3 disturbances: noise 2, clients 1" in text
    assert "0 beyond the level (4.0 m median)" in text
    assert "daemon: resident 170 → 170 → 175 → 175 MiB, 175 at most; 16 to 17 files" in text


def test_what_is_done_is_drawn_by_the_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disturbances, "BEGIN_S", -1.0)
    monkeypatch.setattr(disturbances, "PAUSE_S", (-2.0, -1.0))
    monkeypatch.setattr(disturbances, "KINDS", dict.fromkeys(KINDS, lambda *_: 0.0))
    drawn = []
    with running("-c", "import time; time.sleep(60)") as process:
        for seed in (3, 3, 4):
            made = Disturber(seed, list(KINDS))
            for _ in range(12):
                made(SimpleNamespace(), process)  # type: ignore[arg-type]
            drawn.append(made.done)
    assert drawn[0] == drawn[1] != drawn[2]
    assert len(drawn[0]) == 12


def test_a_stopped_daemon_goes_on_and_is_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("BEGIN_S", -1.0), ("SETTLED_S", -1.0)):
        monkeypatch.setattr(disturbances, name, value)
    counts = "import time\nfor k in range(600):\n print(k, flush=True)\n time.sleep(0.05)"
    with running("-c", counts) as process:
        assert process.stdout is not None
        process.stdout.readline()
        made = Disturber(1, ["daemon stopped"])
        made(SimpleNamespace(), process)  # type: ignore[arg-type]
        seen = [process.stdout.readline() for _ in range(20)]
        assert process.poll() is None
    assert seen[-1] == b"20\n"
    assert made.longest_stop_s >= 0.3
    (taken,) = made.daemon
    assert taken.files >= 3
    assert 1.0 < taken.resident_mib < 100.0


def test_the_localising_process_is_found_and_killed(tmp_path: Any) -> None:
    program = tmp_path / "spawning.py"
    program.write_text(SPAWNING)
    with running(str(program)) as process:
        assert process.stdout is not None
        child = int(process.stdout.readline())
        assert list(disturbances._workers(process)) == [child]
        assert KINDS["worker killed"](random.Random(1), SimpleNamespace(), process) == 0.0  # type: ignore[arg-type]
        assert process.stdout.readline() == b"-9\n"


def test_noise_comes_by_the_link() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link, running("-c", "") as process:
        link.bind(("127.0.0.1", 0))
        link.settimeout(2.0)
        plan: Any = SimpleNamespace(mavlink_port=link.getsockname()[1])
        KINDS["broken packets"](random.Random(1), plan, process)
        packets = [link.recv(2048) for _ in range(50)]
    assert {packet[0] for packet in packets} == {0xFD}
    assert len(set(packets)) == 50


def test_journals_of_real_flights_are_left_alone(tmp_path: Any) -> None:
    kept = tmp_path / "visloc-20260401T101500Z.mcap"
    kept.touch()
    with pytest.raises(ConfigError, match="which no demonstration wrote"):
        flown(tmp_path, "demo", AutopilotKind.ARDUPILOT, 1, disturber())
    assert kept.exists()
