"""The flights against real simulators, before they are flown."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from visloc_companion.errors import ConfigError
from visloc_companion.sim.real.apart import make_pilot
from visloc_companion.sim.real.lives import daemon_config
from visloc_companion.sim.real.pilot import Leg, Route
from visloc_companion.sim.real.programs import Simulator
from visloc_companion.sim.real.scenario import Brake, RealScenario, timeline
from visloc_companion.sim.real.scenarios import NAMES, SEEN, cannot_fly, real_scenario

ROUTE = Route((Leg(0, 100), Leg(100, 0)), 60.0, 10.0)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("simulator", Simulator)
def test_every_flight_is_in_order(name: str, simulator: Simulator) -> None:
    if cannot_fly(name, simulator):
        with pytest.raises(ConfigError, match=f"{simulator} cannot fly '{name}'"):
            real_scenario(name, simulator)
        return
    scenario = real_scenario(name, simulator)
    times = [at_s for at_s, _ in timeline(scenario)]
    assert all(a <= b for a, b in pairwise(times))
    assert all(at_s < scenario.duration_s for at_s in times)
    assert scenario.with_daemon == (name != "without_daemon")


def test_a_drag_grows_until_the_end_and_brakes_are_released() -> None:
    scenario = RealScenario("x", ROUTE, 20.0, drag_at_s=10.0, brakes=(Brake(5.0, 2.0),))
    deeds = timeline(scenario)
    assert deeds[:2] == [(5.0, "brake"), (7.0, "resume")]
    assert deeds[2:4] == [(10.0, "drag"), (10.5, "drag")]
    assert deeds[-1] == (19.5, "drag")


def test_the_daemon_is_killed_when_the_scenario_says() -> None:
    assert [deed for deed in timeline(real_scenario("restarts", Simulator.PX4)) if deed[1] == "restart"] == [
        (100.0, "restart"),
        (140.0, "restart"),
    ]


def test_slow_fixes_have_limits_of_their_own() -> None:
    assert real_scenario("fixes_0_5_hz", Simulator.ARDUCOPTER).p95_limit_m == 8.0
    assert real_scenario("fixes_0_5_hz", Simulator.ARDUPLANE).p95_limit_m == 10.0
    assert real_scenario("fixes_10_hz", Simulator.ARDUPLANE).p95_limit_m is None


def test_rendered_frames_are_taken_from_higher_up() -> None:
    rendered, jam = (real_scenario(name, Simulator.ARDUCOPTER) for name in ("rendered", "jam"))
    assert rendered.route.height_m == 2 * jam.route.height_m
    assert rendered.route.legs == jam.route.legs


def test_rendered_frames_are_answered_late_as_all_others_are() -> None:
    rendered, late, late_rendered = (real_scenario(name, Simulator.PX4) for name in ("rendered", "late", "rendered_late"))
    assert late_rendered.oracle == late.oracle and late_rendered.name in SEEN
    assert late_rendered.oracle.latency_s == pytest.approx(rendered.oracle.latency_s + 0.3)
    assert replace(late_rendered, name=rendered.name, oracle=rendered.oracle) == rendered


def test_flights_with_odometry_are_those_without_but_for_it() -> None:
    for name in ("jam", "late"):
        without, with_it = (real_scenario(each, Simulator.ARDUPLANE) for each in (name, f"{name}_odometry"))
        assert (without.with_odometry, with_it.with_odometry) == (False, True)
        assert with_it.oracle.frames_hz > with_it.oracle.rate_hz == without.oracle.frames_hz
        oracle = replace(with_it.oracle, odometry=False, camera_hz=None)
        assert replace(with_it, name=name, oracle=oracle) == without


def test_what_nobody_helps_is_the_same_flight() -> None:
    jam, alone = (real_scenario(name, Simulator.ARDUPLANE) for name in ("jam", "without_daemon"))
    assert replace(alone, name="jam", with_daemon=True) == jam


def test_rare_fixes_with_odometry_have_no_limits_of_their_own() -> None:
    rare = real_scenario("fixes_0_5_hz_odometry", Simulator.PX4)
    assert rare.p95_limit_m is None and rare.with_odometry
    assert rare.oracle.rate_hz / rare.oracle.recognised_of == 0.5


def test_px4s_copter_flies_over_its_world_with_a_real_ones_drag_as_well(tmp_path: Path) -> None:
    usual, rendered = (real_scenario(name, Simulator.PX4) for name in ("rendered_usual_drag", "rendered"))
    assert usual.route == rendered.route and {usual.name, rendered.name, "rendered_late"} == set(SEEN)
    assert usual.drag_per_s == 0.23 and rendered.drag_per_s is None
    started = {
        flight.name: make_pilot(Simulator.PX4, drag_per_s=flight.drag_per_s).command(Path("/build/bin/px4"), tmp_path, 1.0)[1]
        for flight in (usual, rendered)
    }
    assert started["rendered_usual_drag"]["PX4_PARAM_SIH_KDV"] == "0.23"
    assert "PX4_PARAM_SIH_KDV" not in started["rendered"], "its makers' own"
    with pytest.raises(ConfigError, match="its simulated vehicle has a real one's drag already"):
        real_scenario("rendered_usual_drag", Simulator.ARDUCOPTER)


def test_an_unknown_flight_is_an_error() -> None:
    with pytest.raises(ConfigError, match="there is no flight 'picnic' against a real simulator; remedy: use one of jam, late"):
        real_scenario("picnic", Simulator.PX4)


def test_the_daemon_may_switch_and_hears_the_simulator(tmp_path: Path) -> None:
    config = daemon_config(make_pilot(Simulator.PX4), real_scenario("jam", Simulator.PX4), tmp_path)
    assert config.injection.switch_source
    assert config.link.url == "udpin:127.0.0.1:14541"


@pytest.mark.parametrize("plane", [False, True])
def test_ardupilot_is_started_with_the_users_parameters(plane: bool, tmp_path: Path) -> None:
    pilot = make_pilot(Simulator.ARDUPLANE if plane else Simulator.ARDUCOPTER)
    command, _ = pilot.command(Path("/programs/one"), tmp_path, 3.0)
    files = command[command.index("--defaults") + 1].split(",")
    assert [Path(file).name for file in files] == ["vehicle.parm", "ardupilot.parm"]
    assert all(Path(file).is_file() for file in files)
    assert command[command.index("--model") + 1] == ("plane" if plane else "quad")


def test_ardupilots_of_both_names_brake_alike(tmp_path: Path) -> None:
    """Up to 4.6 in cm/s², from 4.7.0 in m/s²."""
    make_pilot(Simulator.ARDUCOPTER).command(Path("/programs/one"), tmp_path, 1.0)
    lines = (tmp_path / "vehicle.parm").read_text(encoding="ascii").splitlines()
    told = {name: float(value) for name, value in (line.split() for line in lines)}
    assert told["WPNAV_ACCEL"] == 100 * told["WP_ACC"]
    assert told["WPNAV_JERK"] == told["WP_JERK"]


def test_px4_is_started_with_the_users_parameters(tmp_path: Path) -> None:
    _, environment = make_pilot(Simulator.PX4).command(Path("/build/bin/px4"), tmp_path, 3.0)
    assert environment["PX4_PARAM_EKF2_EV_CTRL"] == "1"
    assert environment["PX4_PARAM_EKF2_TAU_POS"] == "0.1"
    assert environment["PX4_PARAM_EKF2_ACC_NOISE"] == "1.0"
    assert environment["PX4_SIM_SPEED_FACTOR"] == "3"


def test_without_gnss_at_boot_the_receiver_is_off_from_the_start(tmp_path: Path) -> None:
    make_pilot(Simulator.ARDUCOPTER).command(Path("/programs/one"), tmp_path, 1.0, gnss=False)
    assert "SIM_GPS1_ENABLE 0" in (tmp_path / "vehicle.parm").read_text(encoding="ascii")
    _, environment = make_pilot(Simulator.PX4).command(Path("/build/bin/px4"), tmp_path, 1.0, gnss=False)
    assert environment["PX4_PARAM_SIM_GPS_USED"] == "0"


def test_px4_flies_a_plane_too(tmp_path: Path) -> None:
    _, environment = make_pilot(Simulator.PX4_PLANE).command(Path("/build/bin/px4"), tmp_path, 1.0)
    assert environment["PX4_SIM_MODEL"] == "sihsim_airplane"


def test_without_the_parameter_files_nothing_is_flown(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"px4\.parm: is missing"):
        make_pilot(Simulator.PX4, tmp_path)
