"""What goes wrong in flight while real autopilots fly on vision: the daemon's death, jumps, outages, odd fixes, no GNSS ever.

Shorter than the flights of docs/autopilots.md, with the same limits: jammed after 20 s, and 70 s on vision.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tests.sitl.conftest import program_or_skip
from visloc_companion.errors import ConfigError
from visloc_companion.evaluate.real.real_flight import checks, real_figures
from visloc_companion.sim.real.programs import Simulator
from visloc_companion.sim.real.scenarios import ORACLE, real_scenario

pytestmark = [pytest.mark.sitl, pytest.mark.timeout(900)]
SHORT = {"duration_s": 90.0, "jam_at_s": 20.0}
COPTERS = [Simulator.ARDUCOPTER, Simulator.PX4]
PX4_ALONE_M = 8.0
"""Within so much for 95 % of a short flight of which it flies 8 s on the gyroscopes of PX4's simulator alone."""


def missed(simulator: Simulator, flown: tuple) -> list[str]:
    """What a flight was asked and did not keep."""
    scenario, log = flown
    figures = real_figures(log, scenario)
    found = [f"{check.name}: {check.value}" for check in checks(figures, scenario, simulator) if not check.passed]
    return [*found, "(this computer was too busy for this flight: fly again)"] if found and figures.starved else found


def alone_m(simulator: Simulator) -> float | None:
    """The limit of a short flight in which the autopilot is left alone for a while, None where that is the usual one."""
    return PX4_ALONE_M if simulator is Simulator.PX4 else None


@pytest.mark.parametrize("simulator", [*COPTERS, Simulator.ARDUPLANE])
def test_a_daemon_that_dies_goes_on_in_time_when_it_is_started_again(fly, simulator: Simulator) -> None:
    assert missed(simulator, fly(simulator, "restarts", restarts=(40.0, 65.0), p95_limit_m=alone_m(simulator), **SHORT)) == []


@pytest.mark.parametrize("simulator", [*COPTERS, Simulator.ARDUPLANE])
def test_a_daemon_that_is_started_again_beside_a_good_gnss_goes_on_until_the_operator_is_back_on_it(fly, simulator) -> None:
    times = {"duration_s": 150.0, "jam_at_s": 20.0, "gnss_back_at_s": 65.0, "restarts": (73.0,)}
    assert missed(simulator, fly(simulator, "restart_after_return", **times)) == []


@pytest.mark.parametrize("simulator", COPTERS)
def test_fixes_that_jump_by_20_m_are_followed(fly, simulator: Simulator) -> None:
    oracle = replace(ORACLE, moved=((40.0, 65.0, 0.0, 20.0),))
    assert missed(simulator, fly(simulator, "jump", oracle=oracle, **SHORT)) == []


@pytest.mark.parametrize("simulator", COPTERS)
def test_outages_of_two_and_six_seconds_are_bridged(fly, simulator: Simulator) -> None:
    oracle = replace(ORACLE, blind=((35.0, 37.0), (50.0, 56.0)))
    assert missed(simulator, fly(simulator, "outages", oracle=oracle, p95_limit_m=alone_m(simulator), **SHORT)) == []


@pytest.mark.parametrize("simulator", [*COPTERS, Simulator.ARDUPLANE])
def test_what_the_air_tells_bridges_a_minute_without_any_sight(fly, simulator: Simulator) -> None:
    """Without it they ended 42, 239 and 92 m off."""
    assert missed(simulator, fly(simulator, "blind_minute")) == []


ODD = [(Simulator.ARDUCOPTER, "late_pictures"), (Simulator.ARDUCOPTER, "jitter"), (Simulator.PX4, "fixes_1_hz")]


@pytest.mark.parametrize(("simulator", "name"), ODD)
def test_late_and_rare_fixes_are_flown_on(fly, simulator: Simulator, name: str) -> None:
    assert missed(simulator, fly(simulator, name, **SHORT)) == []


def test_fixes_that_claim_nothing_are_refused(fly) -> None:
    _, log = fly(Simulator.ARDUPLANE, "claims_nothing", **SHORT)
    assert log.injected_s == []


def test_without_gnss_ever_it_finds_its_place_and_flies(fly) -> None:
    assert missed(Simulator.ARDUCOPTER, fly(Simulator.ARDUCOPTER, "no_gnss_at_boot", duration_s=60.0)) == []


def test_px4s_plane_flies_on_vision(fly) -> None:
    assert missed(Simulator.PX4_PLANE, fly(Simulator.PX4_PLANE, "jam", lands=False, **SHORT)) == []


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_the_command_flies_and_judges(autopilot: str, tmp_path: Path) -> None:
    simulator = Simulator.PX4 if autopilot == "px4" else Simulator.ARDUCOPTER
    program_or_skip(simulator)
    out = tmp_path / "figures.json"
    asked = ["sim", "--autopilot", autopilot, "--scenario", "outages", "--json", str(out)]
    ran = subprocess.run(
        [sys.executable, "-m", "visloc_companion.cli.main", *asked], capture_output=True, text=True, timeout=800, check=False
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "95 % of the autopilot's error on vision" in ran.stdout
    assert json.loads(out.read_text(encoding="utf-8"))["vision_s"] > 100


def test_a_flight_that_a_simulator_cannot_fly_is_refused() -> None:
    with pytest.raises(ConfigError, match="nothing moves PX4's simulated receiver"):
        real_scenario("slow_drag", Simulator.PX4)
