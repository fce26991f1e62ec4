"""Flights by description: names, files of campaigns, results and totals."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from visloc_companion.errors import ConfigError, MapError
from visloc_companion.evaluate import campaign, closed_loop
from visloc_companion.evaluate.campaign import (
    CAMPAIGNS,
    DIALECTS,
    FlightSpec,
    FlownSpec,
    campaign_outcome,
    campaign_specs,
    find_scenario,
    fly_campaign,
    fly_spec,
    result_of,
)
from visloc_companion.evaluate.closed_loop import FlightWorld, simulated_config
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.build import build_pack
from visloc_companion.sim.flight import Eyes
from visloc_companion.sim.scenarios import DEMO, SCENARIOS, SEASON_CHANGE
from visloc_companion.sim.setup import FlightSetup
from visloc_companion.types import GimbalAttitude

REPLAY_FIELDS = {
    *("schema", "duration_s", "n_frames", "n_fixes", "n_no_fix", "reasons", "error_horizontal_m", "availability", "hmi"),
    *("misleading", "nees", "integrity", "gnss", "injected", "latency_ms", "epochs"),
}
SIM_FIELDS = {"scenario", "autopilot", "vehicle", "seed", "failsafe", "pulled_m", "modes", "verdicts", "passed", "expected"}
EXTRAS = {"judged", "dialect", "method", "with_daemon", "same_image", "structure", "gimbal", "fixes_by_method"}
NOWHERE = Path()
MakeEyes = Callable[..., Eyes]


@pytest.fixture
def spec(tiny_world: Any) -> FlightSpec:
    return FlightSpec("jam", tiny_world.pack, tiny_world.ortho, tiny_world.dsm)


def numbers(value: Any) -> list[float]:
    if isinstance(value, dict):
        return [number for item in value.values() for number in numbers(item)]
    if isinstance(value, list | tuple):
        return [number for item in value for number in numbers(item)]
    return [value] if isinstance(value, float) else []


@pytest.mark.usefixtures("short_jam")
def test_the_result_has_the_fields_of_the_interface(
    spec: FlightSpec, oracle_eyes: MakeEyes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(closed_loop, "eyes_over", lambda *_: oracle_eyes())
    told: list[float] = []
    flown = fly_spec(replace(spec, dialect="px4", vehicle="plane", seed=3), told.append)
    result = json.loads(json.dumps(result_of(flown, "gradient"), allow_nan=False))
    assert set(result) == REPLAY_FIELDS | SIM_FIELDS | EXTRAS
    assert set(result["error_horizontal_m"]) == {"mean", "median", "p95", "max"}
    assert set(result["gnss"]) == {"detected_at_s", "false_alarms"}
    assert set(result["injected"]) == {"n", "rate_hz", "gap_max_ms"}
    assert set(result["latency_ms"]) == {"p50", "p95", "p99"}
    assert all(math.isfinite(number) for number in numbers(result))
    assert [result[name] for name in ("scenario", "autopilot", "dialect", "vehicle", "seed")] == [
        "jam",
        "built-in",
        "px4",
        "plane",
        3,
    ]
    assert (result["judged"], result["passed"]) == (True, True)
    assert result["failsafe"] is None
    assert {"name", "value", "limit", "passed"} == set(result["expected"][0])
    assert [name for _, name in result["modes"]] == ["waiting", "shadow", "aiding"]
    assert [name for _, name in result["verdicts"]] == ["denied", "ok", "denied"]
    assert result["verdicts"][-1][0] == result["gnss"]["detected_at_s"] == pytest.approx(13.5, abs=1.5)
    assert len(told) == 30


@pytest.mark.usefixtures("short_jam")
@pytest.mark.parametrize("dialect", DIALECTS)
def test_any_scenario_can_be_flown_with_the_camera_on_a_gimbal(
    dialect: str, spec: FlightSpec, oracle_eyes: MakeEyes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The autopilot is asked how the gimbal points, says so, and frames are placed by that, as jammed as before."""
    monkeypatch.setattr(closed_loop, "eyes_over", lambda *_: oracle_eyes())
    flown = fly_spec(replace(spec, dialect=dialect, gimbal=True))
    assert flown.passed, flown.checks
    assert result_of(flown, "gradient")["gimbal"] is True
    assert simulated_config(flown.setup).camera.mount == "gimbal"
    events = [entry.event for entry in flown.log.entries]
    assert sum(isinstance(event, GimbalAttitude) for event in events) > 20 * flown.log.duration_s


def test_without_a_gimbal_none_is_told_of(spec: FlightSpec, oracle_eyes: MakeEyes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(closed_loop, "eyes_over", lambda *_: oracle_eyes())
    monkeypatch.setitem(campaign.FLIGHTS, "jam", replace(SCENARIOS["jam"], duration_s=20.0))  # one is told of 20 times a second
    fixed = fly_spec(spec)
    assert result_of(fixed, "gradient")["gimbal"] is False
    assert not any(isinstance(entry.event, GimbalAttitude) for entry in fixed.log.entries)


def test_a_scenario_keeps_the_gimbal_that_it_has(spec: FlightSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    setups: list[FlightSetup] = []
    monkeypatch.setattr(campaign, "fly", lambda setup, *_, **__: setups.append(setup))
    fly_spec(replace(spec, scenario="gimbal_to_horizon", gimbal=True))
    assert [setup.scenario for setup in setups] == [SCENARIOS["gimbal_to_horizon"]]


def test_without_the_daemon_nothing_is_expected(spec: FlightSpec) -> None:
    result = result_of(fly_spec(replace(spec, scenario="slow_drag", with_daemon=False)), "gradient", with_daemon=False)
    json.dumps(result, allow_nan=False)
    assert (result["n_frames"], result["expected"], result["passed"], result["modes"]) == (0, [], True, [])
    assert result["judged"] is False
    assert result["pulled_m"] == pytest.approx(120.0, abs=3.0)
    assert result["with_daemon"] is False


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"scenario": "picnic"}, "unknown scenario 'picnic'.*jam, .*demo"),
        ({"dialect": "betaflight"}, "unknown dialect 'betaflight'.*ardupilot, px4"),
        ({"vehicle": "boat"}, "unknown vehicle 'boat'.*copter, plane"),
        ({"method": "guess"}, "unknown method 'guess'.*gradient"),
        ({"seed": "1"}, "seed is '1', no int"),
        ({"seed": True}, "seed is True, no int"),
        ({"seed": -1}, "seed is -1.*from 0 on"),
        ({"with_daemon": 1}, "with_daemon is 1, no bool"),
        ({"gimbal": "down"}, "gimbal is 'down', no bool"),
        ({"scenario": ["jam"]}, "scenario is .*, no str"),
    ],
)
def test_a_flight_that_is_none_is_refused(change: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        FlightSpec(**{"scenario": "jam", "pack": NOWHERE, "camera_ortho": NOWHERE, "camera_dsm": None} | change)


def test_a_byte_order_mark_before_a_campaign_is_no_fault(spec: FlightSpec, tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text('[{"scenario": "jam"}]', encoding="utf-8-sig")
    assert [one.scenario for one in campaign_specs(str(tmp_path / "c.json"), spec)] == ["jam"]


def test_scenarios_are_found_by_name() -> None:
    assert find_scenario("demo") is DEMO
    assert find_scenario("season_change") is SEASON_CHANGE
    assert find_scenario("no_gnss") is SCENARIOS["no_gnss"]


def test_files_that_are_not_there_are_named(spec: FlightSpec, tmp_path: Path) -> None:
    with pytest.raises(MapError, match="none"):
        fly_spec(replace(spec, pack=tmp_path / "none"))
    with pytest.raises(MapError, match=r"none\.tif"):
        fly_spec(replace(spec, camera_ortho=tmp_path / "none.tif"))


def test_without_a_surface_model_of_its_own_the_scene_has_the_packs(spec: FlightSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    """A plane below a hill that the map knows would be another place."""
    highest_m: list[float] = []

    def fly(setup: FlightSetup, world: FlightWorld, **_: object) -> None:
        highest_m.append(float(world.scene.dsm_amsl_m.max()))

    monkeypatch.setattr(campaign, "fly", fly)
    fly_spec(replace(spec, camera_dsm=None))
    assert highest_m == [pytest.approx(310.0, abs=0.5)]


def test_the_flight_keeps_to_what_the_camera_is_to_see(spec: FlightSpec, write_raster: Any, tmp_path: Path) -> None:
    """An orthophoto of a part of the map, and one of another place: both once flew over the colour of hazy air."""
    pack = PackMap.open(spec.pack)
    middle = pack.to_geo(*pack.center_map_m)
    pixels = np.zeros((200, 200, 3), np.uint8)
    write_raster(tmp_path / "part.tif", pixels, "EPSG:32632", middle, 1.0)
    with pytest.raises(MapError, match="reach 100 m from the middle, too little for a flight"):
        fly_spec(replace(spec, camera_ortho=tmp_path / "part.tif", camera_dsm=None, with_daemon=False))
    for north_deg, complaint in (
        (0.0018, r"lies 100 m beyond what the camera is to see.*--camera-ortho of the same place"),
        (0.01, r"dsm\.tif: does not overlap \S*away\.tif.*of the same place"),
    ):
        write_raster(tmp_path / "away.tif", pixels, "EPSG:32632", (middle[0] + north_deg, middle[1]), 1.0)
        with pytest.raises(MapError, match=complaint):
            fly_spec(replace(spec, camera_ortho=tmp_path / "away.tif", camera_dsm=None, with_daemon=False))


@pytest.mark.usefixtures("short_jam")
@pytest.mark.parametrize(("east_deg", "flies"), [(0.0, False), (1e-5, True)])
def test_a_home_that_autopilots_take_for_none_is_refused(
    east_deg: float, flies: bool, write_raster: Any, tmp_path: Path, oracle_eyes: MakeEyes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every message of a position at 0, 0 is dropped as unknown: the daemon never had an origin, and nothing said why."""
    monkeypatch.setattr(closed_loop, "eyes_over", lambda *_: oracle_eyes())
    write_raster(tmp_path / "ortho.tif", np.full((400, 400, 3), 90, np.uint8), "EPSG:32631", (0.0, east_deg), 1.0)
    write_raster(tmp_path / "dsm.tif", np.full((400, 400), 10.0, np.float32), "EPSG:32631", (0.0, east_deg), 1.0)
    build_pack([tmp_path / "ortho.tif"], tmp_path / "dsm.tif", tmp_path / "pack", capture_date="2026-01-01")
    spec = FlightSpec("jam", tmp_path / "pack", tmp_path / "ortho.tif", tmp_path / "dsm.tif")
    if flies:
        assert fly_spec(spec).passed
    else:
        with pytest.raises(MapError, match=r"pack: has its middle at latitude 0, longitude 0, .*know no position"):
            fly_spec(spec)


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_a_named_campaign_flies_every_scenario(name: str, spec: FlightSpec) -> None:
    specs = campaign_specs(name, spec)
    dialects, vehicles, seeds = CAMPAIGNS[name]
    assert len(specs) == len(set(specs)) == len(SCENARIOS) * len(dialects) * len(vehicles) * len(seeds)
    assert {one.scenario for one in specs} == set(SCENARIOS)
    assert {one.pack for one in specs} == {spec.pack}


def test_a_campaign_file_changes_the_template(spec: FlightSpec, tmp_path: Path) -> None:
    path = tmp_path / "campaign.json"
    path.write_text(json.dumps([{"scenario": "jam", "gimbal": True}, {"scenario": "demo", "dialect": "px4", "vehicle": "plane"}]))
    assert campaign_specs(str(path), spec) == [
        replace(spec, gimbal=True),
        replace(spec, scenario="demo", dialect="px4", vehicle="plane"),
    ]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("{", "is no campaign"),
        ("[]", "holds no list of flights"),
        (f'[{{"scenario": "jam", "seed": {"1" * 5000}}}]', "is no campaign: Exceeds the limit"),
        ("[" * 100_000, "is no campaign: (maximum recursion depth|Stack overflow)"),
        ('{"scenario": "jam"}', "holds no list of flights"),
        ('[{"seed": 1}]', "entry 0 needs scenario"),
        ('["jam"]', "entry 0 needs scenario"),
        ('[{"scenario": "jam"}, {"scenario": "jam", "sead": 1}]', "entry 1 needs scenario and may have dialect"),
        ('[{"scenario": "jam"}, {"scenario": "picnic"}]', "entry 1: unknown scenario 'picnic'"),
        ('[{"scenario": "jam", "scenario": "demo"}]', "is no campaign: 'scenario' twice in one entry, {'scenario': 'demo'}"),
        ('[{"scenario": "jam", "dialect": "PX4"}]', r"entry 0: unknown dialect 'PX4' \(did you mean 'px4'\?\)"),
        ('[{"scenario": "jam", "seed": 1.5}]', "entry 0: seed is 1.5, no int"),
    ],
)
def test_a_wrong_campaign_file_is_named_with_its_entry(spec: FlightSpec, tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "campaign.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=complaint) as caught:
        campaign_specs(str(path), spec)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("entry", "told"),
    [
        ({"scenario": "jam", "sead": 1}, r"unknown 'sead' \(did you mean 'seed'\?\); remedy: correct the key"),
        ({"scenario": "jam", "height_m": 90, "sed": 2}, r"unknown 'height_m', 'sed' \(did you mean 'seed'\?\); remedy: correct"),
        ({"scenarios": "jam"}, r"unknown 'scenarios' \(did you mean 'scenario'\?\); remedy: correct the key"),
        ({"scenario": "jam", "autopilot": "px4"}, r"unknown 'autopilot' \(flights of a file have .* 'dialect' says"),
        ({"scenario": "jam", "map": "pack", "jobs": 2}, r"unknown 'jobs' \(--jobs is .*\), 'map' \(--map is that of all"),
        ({"scenario": "jam", "without_daemon": True}, r"unknown 'without_daemon' \(write \"with_daemon\": false\)"),
        ({"SCENARIO": "jam"}, r"unknown 'SCENARIO' \(did you mean 'scenario'\?\)"),
        ({"seed": 1}, "it names none; remedy: add scenario, one of visloc sim --list"),
        ("jam", r"it is 'jam', no object; remedy: write \{\"scenario\": NAME\}"),
    ],
)
def test_what_is_wrong_with_an_entry_is_named(spec: FlightSpec, tmp_path: Path, entry: object, told: str) -> None:
    path = tmp_path / "campaign.json"
    path.write_text(json.dumps([{"scenario": "jam"}, entry]), encoding="utf-8")
    with pytest.raises(ConfigError, match=rf"campaign\.json: entry 1 .*{told}"):
        campaign_specs(str(path), spec)


def test_a_scenario_that_is_nearly_one_is_told(spec: FlightSpec) -> None:
    with pytest.raises(ConfigError, match=r"unknown scenario 'jamm' \(did you mean 'jam'\?\); remedy: one of jam, "):
        replace(spec, scenario="jamm")


def test_an_unknown_campaign_names_the_known_ones(spec: FlightSpec) -> None:
    with pytest.raises(ConfigError, match="scenarios, vehicles or a JSON file"):
        campaign_specs("nothing", spec)


def test_a_campaign_adds_its_flights_up(spec: FlightSpec) -> None:
    """In processes of their own, written in the order asked for."""
    names = ["step_spoof", "no_gnss"]
    flown = list(fly_campaign([replace(spec, scenario=name, with_daemon=False) for name in names], 2))
    outcome = campaign_outcome(flown, 2)
    assert [flight["scenario"] for flight in outcome["flights"]] == names
    assert outcome["complete"]
    assert outcome["totals"] == {
        "flights": 2,
        "passed": 2,
        "judged": 0,
        "fix_epochs": 0,
        "hmi": 0,
        "availability": None,
        "protection_level_median_m": None,
        "error_median_m": None,
    }
    json.dumps(outcome, allow_nan=False)


def test_what_a_flight_raises_ends_the_campaign_after_those_that_ended_before(spec: FlightSpec, tmp_path: Path) -> None:
    good, bad = replace(spec, with_daemon=False), replace(spec, pack=tmp_path / "none")
    flights = fly_campaign([good, bad, good], 1)
    ended = [next(flights)]
    with pytest.raises(MapError, match="none"):
        next(flights)
    outcome = campaign_outcome(ended, 3)
    assert (outcome["complete"], outcome["asked"], outcome["totals"]["flights"]) == (False, 3, 1)


def test_an_interrupted_campaign_begins_no_other_flight(spec: FlightSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the pool had queued was flown to its end after Ctrl-C."""
    pools, begun = list[ThreadPoolExecutor](), list[int]()

    def threads(jobs: int, **_: object) -> ThreadPoolExecutor:
        pools.append(ThreadPoolExecutor(jobs))
        return pools[0]

    def fly_one(number: int, _: FlightSpec) -> FlownSpec:
        begun.append(number)
        if number == 1:
            raise KeyboardInterrupt
        return FlownSpec(number, {}, np.zeros(1), np.zeros(1))

    monkeypatch.setattr(campaign, "ProcessPoolExecutor", threads)
    monkeypatch.setattr(campaign, "_fly_one", fly_one)
    flights = fly_campaign([spec] * 4, 1)
    assert next(flights).number == 0
    with pytest.raises(KeyboardInterrupt):
        next(flights)
    pools[0].shutdown()
    assert begun == [0, 1]
