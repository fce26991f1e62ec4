"""Finding and running the simulators' programs."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from visloc_companion.errors import ConfigError
from visloc_companion.sim.real.apart import fly_apart
from visloc_companion.sim.real.programs import LOG, Running, Simulator, find_program, running
from visloc_companion.sim.real.scenarios import real_scenario


def test_a_program_that_is_not_there_is_an_error_that_says_what_to_set(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("VISLOC_ARDUCOPTER", raising=False)
    with pytest.raises(ConfigError, match=r"no arducopter on PATH; remedy: .*VISLOC_ARDUCOPTER"):
        find_program(Simulator.ARDUCOPTER)


def test_a_variable_that_names_no_program_is_an_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("VISLOC_PX4", str(tmp_path / "px4"))
    with pytest.raises(ConfigError, match=r"VISLOC_PX4 names .*px4, which is no program"):
        find_program(Simulator.PX4)


def test_the_variable_wins_over_the_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VISLOC_ARDUPLANE", sys.executable)
    assert find_program(Simulator.ARDUPLANE) == Path(sys.executable).resolve()


def test_a_running_program_ends_with_its_children_and_leaves_its_last_words(tmp_path: Path) -> None:
    child = "[sys.executable, '-c', 'import time; time.sleep(60)']"
    code = f"import subprocess, sys; print('hello', flush=True); subprocess.run({child})"
    with running([sys.executable, "-c", code], tmp_path, {"VISLOC_TEST": "1"}) as simulator:
        for _ in range(200):
            if "hello" in simulator.last_words():
                break
            time.sleep(0.02)
        assert not simulator.ended
    assert simulator.ended
    assert "hello" in simulator.last_words()


def test_time_stands_still_while_a_program_is_held(tmp_path: Path) -> None:
    code = "import time\nwhile True:\n    print('x', flush=True)\n    time.sleep(0.001)"
    with running([sys.executable, "-c", code], tmp_path, {}) as simulator:
        said = tmp_path / LOG
        wait_for(lambda: said.stat().st_size > 0)
        with simulator.held():
            wait_for(lambda: state_of(simulator) == "T")
            before = said.stat().st_size
            time.sleep(0.05)
            assert said.stat().st_size == before
        wait_for(lambda: said.stat().st_size > before)


def wait_for(condition: Callable[[], bool]) -> None:
    for _ in range(1000):
        if condition():
            return
        time.sleep(0.01)
    raise AssertionError


def state_of(simulator: Running) -> str:
    """The letter of the process's state in /proc."""
    return Path(f"/proc/{simulator.pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()[0]


def test_a_folder_in_which_another_flight_left_its_parameters_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """PX4 took up the parameters of the flight before, GNSS switched off among them, and could not be armed."""
    monkeypatch.setenv("VISLOC_PX4", sys.executable)
    (tmp_path / "parameters.bson").write_bytes(b"")
    with pytest.raises(ConfigError, match=r"holds something already.*; remedy: name a new folder, or empty it"):
        fly_apart(Simulator.PX4, real_scenario("jam", Simulator.PX4), keep=tmp_path)
