"""`visloc sim --campaign` that somebody ends, or whose flight is killed: what was flown is written, nothing flies on."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.unit.processes import is_alive

CAMPAIGN = """
import os, signal, sys, time
import numpy as np
from visloc_companion.cli.main import main
from visloc_companion.evaluate import campaign

def fly_one(number, spec):
    if number > 0:
        time.sleep(0.3)  # the campaign has the first flight's result by then
        os.write(1, f"\\nflying in {os.getpid()}\\n".encode())  # whole, amid what the campaign says meanwhile
        time.sleep(60)
    figures = {"error_horizontal_m": {"median": 1.0, "max": 2.0}, "pulled_m": 0.0, "gnss": {"detected_at_s": 31.0}}
    more = {"passed": True, "failsafe": None, "availability": 1.0, "n_fixes": 9, "hmi": 0, "same_image": False, "gimbal": False}
    more["judged"] = True
    names = {"scenario": "jam", "dialect": "px4", "vehicle": "copter", "seed": 1, "with_daemon": True}
    return campaign.FlownSpec(number, figures | more | names, np.ones(3), np.ones(3))

campaign._fly_one = fly_one
if __name__ == "__main__":
    main()
"""

TORN = """
from concurrent.futures import _base

class Torn(_base._AcquireFutures):
    def __exit__(self, *_):
        *others, last = self.futures
        for future in others:
            future._condition.release()
        if not os.path.exists("torn"):
            open("torn", "w").close()
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(0.01)
        last._condition.release()

if __name__ == "__main__":
    _base._AcquireFutures = Torn
"""


@contextmanager
def second_of_three_flights(folder: Path) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """The campaign and the process id of its second flight, which would take a minute."""
    (folder / "campaign.py").write_text(CAMPAIGN, encoding="utf-8")
    (folder / "three.json").write_text(json.dumps([{"scenario": "jam"}] * 3), encoding="utf-8")
    command = [sys.executable, "campaign.py", "sim", "--campaign", "three.json", "--map", "none", "--json", "out.json"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=folder, stdout=pipe, stderr=pipe, text=True) as parent:
        assert parent.stdout is not None
        flying = next(line for line in parent.stdout if line.startswith("flying in"))
        worker = int(flying.split()[-1])
        try:
            yield parent, worker
        finally:
            parent.kill()
            if is_alive(worker):
                os.kill(worker, signal.SIGKILL)


def written(folder: Path) -> dict[str, Any]:
    outcome: dict[str, Any] = json.loads((folder / "out.json").read_text(encoding="utf-8"))
    return outcome


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_whoever_ends_a_campaign_ends_its_flights(tmp_path: Path, number: signal.Signals) -> None:
    """`timeout 600 visloc sim --campaign` lost all that was flown, and its last flight went on to its end."""
    with second_of_three_flights(tmp_path) as (parent, worker):
        parent.send_signal(number)
        assert parent.wait(30) == 128 + number
        assert not is_alive(worker)
    outcome = written(tmp_path)
    assert (outcome["complete"], outcome["asked"], outcome["totals"]["flights"]) == (False, 3, 1)


def test_a_campaign_that_is_ended_amid_the_locks_of_its_pool_ends(tmp_path: Path) -> None:
    """The signal raised there, a lock was held for ever, and the process waited for its pool for ever."""
    (tmp_path / "campaign.py").write_text(
        CAMPAIGN.replace("campaign._fly_one = fly_one\n", "campaign._fly_one = fly_one\n" + TORN), encoding="utf-8"
    )
    (tmp_path / "three.json").write_text(json.dumps([{"scenario": "jam"}] * 3), encoding="utf-8")
    command = [sys.executable, "campaign.py", "sim", "--campaign", "three.json", "--map", "none", "--jobs", "2"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as parent:
        try:
            assert parent.wait(30) == 128 + signal.SIGTERM
        finally:
            parent.kill()  # its flights end with it
    assert (tmp_path / "torn").exists()


def test_a_flight_that_is_killed_is_told_in_one_line(tmp_path: Path) -> None:
    """A traceback and exit code 1, which means a failed gate, once told of it."""
    with second_of_three_flights(tmp_path) as (parent, worker):
        os.kill(worker, signal.SIGKILL)
        assert parent.stderr is not None
        told = parent.stderr.read()
        assert parent.wait(30) == 3
    assert "error: the process of a flight was killed; remedy: where memory ran out: fewer --jobs" in told
    assert "Traceback" not in told
    assert written(tmp_path)["complete"] is False
