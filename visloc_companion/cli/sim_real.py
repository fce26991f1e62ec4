"""`visloc sim --autopilot ardupilot|px4`: the real daemon against the real autopilot's own simulator."""

from __future__ import annotations

import tempfile
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from visloc_companion.errors import ConfigError

if TYPE_CHECKING:
    from visloc_companion.sim.real.programs import Simulator

SPEED = 2.0


def fly_real(autopilot: str, vehicle: str, name: str, seed: int, with_daemon: bool, json_file: Path | None) -> None:
    """Fly one of sim/real/scenarios.py and judge it. Exit code 1 when it does not show what is expected.

    Raises ConfigError for names that there are not and where the program is missing.
    """
    from visloc_companion.cli.progress import require_folder
    from visloc_companion.cli.sim_result import write_result
    from visloc_companion.evaluate.real.real_flight import checks, real_figures
    from visloc_companion.evaluate.real.real_result import real_record, real_result
    from visloc_companion.evaluate.real.real_world import over_its_world
    from visloc_companion.sim.real.apart import fly_apart
    from visloc_companion.sim.real.programs import find_program
    from visloc_companion.sim.real.scenarios import real_scenario

    simulator = chosen_simulator(autopilot, vehicle)
    scenario = real_scenario(name, simulator, seed)
    require_folder(json_file, "--json")
    find_program(simulator)  # before a world is made
    scenario = over_its_world(scenario)
    scenario = replace(scenario, with_daemon=with_daemon and name != "without_daemon")
    with tempfile.TemporaryDirectory(prefix="visloc-real-") as kept:
        log = fly_apart(simulator, scenario, speed=SPEED, keep=Path(kept))
        figures = real_figures(log, scenario)
        judged = checks(figures, scenario, simulator) if scenario.with_daemon else []
        try:
            for field, value in asdict(figures).items():
                typer.echo(f"{field:16} {value}")
            for check in judged:
                typer.echo(f"  {'ok  ' if check.passed else 'FAIL'} {check.name}: {check.value} (limit {check.limit})")
        finally:  # a reader of the words that went away must not cost the flight
            if json_file is not None:
                record = real_record(log, Path(kept))
                write_result(record, real_result(log, scenario, simulator, figures, judged, record), json_file)
    if figures.starved:
        typer.echo(
            f"warning: this computer was too busy for a flight at {SPEED:g} times real time, which shows nothing then; "
            "remedy: end other work, and fly again",
            err=True,
        )
    if not all(check.passed for check in judged):
        raise typer.Exit(1)


def chosen_simulator(autopilot: str, vehicle: str) -> Simulator:
    """Which program flies. Raises ConfigError."""
    from visloc_companion.sim.real.programs import Simulator

    choices = {
        ("ardupilot", "copter"): Simulator.ARDUCOPTER,
        ("ardupilot", "plane"): Simulator.ARDUPLANE,
        ("px4", "copter"): Simulator.PX4,
        ("px4", "plane"): Simulator.PX4_PLANE,
    }
    if (autopilot, vehicle) not in choices:
        known = ", ".join(f"--autopilot {one} --vehicle {two}" for one, two in choices)
        raise ConfigError(
            f"there is no simulator of {autopilot} with a {vehicle}", remedy=f"use --autopilot built-in, or {known}"
        )
    return choices[autopilot, vehicle]
