"""Finds the simulators' programs and runs them in folders of their own."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from visloc_companion.app.with_parent import end_with_starter
from visloc_companion.errors import ConfigError
from visloc_companion.sim.real.priority import go_first

LOG = "autopilot.log"
_END_S = 5.0
_running: set[int] = set()


class Simulator(StrEnum):
    """A real autopilot with the simulated vehicle that its own program brings."""

    ARDUCOPTER = "arducopter"
    ARDUPLANE = "arduplane"
    PX4 = "px4"
    PX4_PLANE = "px4_plane"

    @property
    def is_plane(self) -> bool:
        """Whether it flies a plane."""
        return self in (Simulator.ARDUPLANE, Simulator.PX4_PLANE)

    @property
    def is_px4(self) -> bool:
        """Whether the autopilot is PX4."""
        return self in (Simulator.PX4, Simulator.PX4_PLANE)


@dataclass(frozen=True, slots=True)
class Whereabouts:
    """The environment variable that names a program, its name on PATH, and where to get it."""

    variable: str
    name: str
    source: str


_PX4 = Whereabouts("VISLOC_PX4", "px4", "PX4's SITL build (make px4_sitl_default)")
WHEREABOUTS: dict[Simulator, Whereabouts] = {
    Simulator.ARDUCOPTER: Whereabouts("VISLOC_ARDUCOPTER", "arducopter", "ArduPilot's SITL build of Copter (waf copter)"),
    Simulator.ARDUPLANE: Whereabouts("VISLOC_ARDUPLANE", "arduplane", "ArduPilot's SITL build of Plane (waf plane)"),
    Simulator.PX4: _PX4,
    Simulator.PX4_PLANE: _PX4,
}


def find_program(simulator: Simulator) -> Path:
    """The program of a simulator. Raises ConfigError naming the variable and what to install."""
    where = WHEREABOUTS[simulator]
    named = os.environ.get(where.variable)
    found = shutil.which(named or where.name)
    if found is None:
        what = f"{where.variable} names {named}, which is no program" if named else f"no {where.name} on PATH"
        raise ConfigError(what, remedy=f"build {where.source} and set {where.variable} to the program")
    return Path(found).resolve()


class Running:
    """A started program."""

    def __init__(self, process: subprocess.Popen[bytes], folder: Path) -> None:
        self._process, self.folder = process, folder

    @property
    def pid(self) -> int:
        """Its process."""
        return self._process.pid

    @property
    def ended(self) -> bool:
        """Whether the program is gone."""
        return self._process.poll() is not None

    @contextmanager
    def held(self) -> Iterator[None]:
        """Stop the program where it is, so that simulated time stands still, and let it run on at the end."""
        self._process.send_signal(signal.SIGSTOP)
        try:
            yield
        finally:
            self._process.send_signal(signal.SIGCONT)

    def last_words(self) -> str:
        """The end of what it printed."""
        return (self.folder / LOG).read_text(encoding="utf-8", errors="replace")[-500:]


@contextmanager
def running(command: Sequence[str], folder: Path, environment: Mapping[str, str]) -> Iterator[Running]:
    """Run a program in a folder, its output in `autopilot.log` there, first in turn; it is killed at the end, children too.

    Where this process is killed (memory), the program is as well: it would fly on for ever, ahead of all others.
    """
    with (folder / LOG).open("wb") as log:
        process = subprocess.Popen(
            command,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            env={**os.environ, **environment},
            start_new_session=True,
            preexec_fn=end_with_starter,  # noqa: PLW1509 - takes no lock
        )
        _running.add(process.pid)
        go_first(process.pid)
        try:
            yield Running(process, folder)
        finally:
            _kill(process.pid)
            process.wait(_END_S)
            _running.discard(process.pid)


def kill_all() -> None:
    """Kill what `running` has started, for a process that ends without coming to the end of it."""
    for pid in tuple(_running):
        _kill(pid)


def _kill(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)
