"""The library of flights says what goes wrong, when, and expects what can be seen."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from visloc_companion.errors import ConfigError
from visloc_companion.sim.faults import FaultSchedule
from visloc_companion.sim.scenarios import DEMO, FLIGHTS, SCENARIOS, SEASON_CHANGE, Scenario
from visloc_companion.types import Mode, Verdict

WANTED = {
    *("jam", "step_spoof", "slow_drag", "meaconing", "gnss_returns_bad", "stale_map", "season_change", "haze", "blur"),
    *("rolling_shutter", "night", "over_water", "sharp_turns", "camera_freeze", "frames_late", "autopilot_clock_step"),
    "camera_stuck",
    *("companion_clock_step", "compass_error", "baro_drift", "tilted_mount", "wrong_focal_length", "link_gaps", "worker_crash"),
    *("map_edge", "map_shifted", "no_gnss"),
}


def test_every_fault_has_a_flight() -> None:
    assert set(SCENARIOS) >= WANTED
    assert set(FLIGHTS) == {*SCENARIOS, "demo", "long_jam"}
    assert all(scenario.name == name and scenario.summary.endswith(".") for name, scenario in FLIGHTS.items())


@pytest.mark.parametrize("scenario", FLIGHTS.values(), ids=lambda scenario: scenario.name)
def test_every_fault_falls_into_the_flight(scenario: Scenario) -> None:
    """GNSS is right until its fault; what is expected can be seen within the flight."""
    start_s, expected = scenario.fault_start_s, scenario.expected
    effects = {t_s: scenario.faults.gnss(float(t_s)) for t_s in range(round(scenario.duration_s))}
    assert not [t_s for t_s, effect in effects.items() if (effect.jammed or effect.spoofed) and t_s < start_s]
    assert effects[math.ceil(start_s)].jammed or effects[math.ceil(start_s)].spoofed
    assert expected.verdict_within_s is not None
    assert start_s + expected.verdict_within_s < scenario.duration_s - 20.0
    last = effects[round(scenario.duration_s) - 1]
    assert (Verdict.OK in expected.final_verdicts) == (not last.jammed and not last.spoofed) or scenario.name == "jam_on_and_off"


@pytest.mark.parametrize("scenario", FLIGHTS.values(), ids=lambda scenario: scenario.name)
def test_what_is_expected_goes_together(scenario: Scenario) -> None:
    """A flight has limits on its errors, or it says that it is lost; only then may the autopilot's failsafe come."""
    expected = scenario.expected
    lost = Mode.LOST in expected.modes
    assert lost == expected.failsafe == (expected.max_error_m is None) == (expected.median_error_m is None)
    assert lost == (expected.final_modes == (Mode.LOST,))
    assert scenario.pictures or (scenario.changes == () and scenario.course == "loop" and scenario.date == "flight")


def test_a_plane_may_end_in_a_turn_in_which_it_is_not_recognised() -> None:
    """frames_late ended 1 s after the last fix, 40 degrees banked, and failed for that."""
    for name, final_modes in (
        ("frames_late", {Mode.AIDING, Mode.DEAD_RECKONING}),
        ("season_change", {Mode.AIDING, Mode.DEAD_RECKONING}),
        ("gnss_returns_good", {Mode.SHADOW}),
        ("open_sea", {Mode.LOST}),
    ):
        of_a_plane = SCENARIOS[name].expected.of_a_plane
        assert set(of_a_plane.final_modes) == final_modes
        assert len(of_a_plane.final_modes) == len(final_modes)
        assert of_a_plane.max_error_m == SCENARIOS[name].expected.max_error_m
    assert SCENARIOS["frames_late"].expected.final_modes == (Mode.AIDING,), "a copter is recognised all the time"


def test_a_slow_drag_pulls_position_and_velocity_alike() -> None:
    drag = SCENARIOS["slow_drag"].faults
    assert drag.gnss(50.0).offset_ned_m == pytest.approx((0.0, 20.0, 0.0))
    assert drag.gnss(50.0).offset_v_ned_mps == pytest.approx((0.0, 1.0, 0.0))


def test_gnss_returns_at_a_wrong_place() -> None:
    fault = SCENARIOS["gnss_returns_bad"].faults
    assert fault.gnss(69.9).jammed
    back = fault.gnss(70.1)
    assert not back.jammed
    assert math.hypot(*back.offset_ned_m) == pytest.approx(78.1, abs=0.1)


def test_two_cameras_freeze_one_with_the_very_same_pixels_and_one_without() -> None:
    frozen = {
        name: [t_s for t_s in range(200) if scenario.faults.camera_frozen(float(t_s))] for name, scenario in SCENARIOS.items()
    }
    assert frozen.pop("camera_freeze") == list(range(60, 72))
    assert frozen.pop("camera_stuck") == list(range(25, 45))
    assert [SCENARIOS[name].faults.camera_anew(30.0) for name in ("camera_freeze", "camera_stuck")] == [False, True]
    assert not SCENARIOS["camera_freeze"].faults.camera_anew(65.0)
    assert not any(frozen.values())


def test_the_demonstration_is_dragged_then_jammed() -> None:
    assert DEMO.fault_start_s == 60.0
    assert DEMO.faults.gnss(119.9).spoofed
    assert not DEMO.faults.gnss(119.9).jammed
    assert DEMO.faults.gnss(120.1).jammed


def test_only_the_change_of_season_is_seen_under_snow_and_asks_for_structure() -> None:
    others = [scenario for scenario in FLIGHTS.values() if scenario is not SEASON_CHANGE]
    assert {(scenario.date, scenario.expected.structure_share) for scenario in others} == {("flight", 0.0)}
    assert SEASON_CHANGE.date == "snow"
    assert SEASON_CHANGE.expected.structure_share >= 0.2
    assert SEASON_CHANGE.faults.gnss(SEASON_CHANGE.duration_s - 1).jammed


def test_a_flight_without_faults_has_no_start_of_them() -> None:
    assert Scenario("calm", "Nothing.", 60.0, FaultSchedule()).fault_start_s == math.inf
    assert SCENARIOS["no_gnss"].fault_start_s == 0.0


@pytest.mark.parametrize("wrong", [{"duration_s": 0.0}, {"duration_s": math.inf}, {"frame_rate_hz": 0.0}, {"height_m": -80.0}])
def test_a_scenario_that_cannot_be_flown_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        replace(SCENARIOS["jam"], **wrong)  # type: ignore[arg-type]
