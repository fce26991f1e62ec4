"""Which vehicle stands beside which simulator, and that the rows get its figures; no flight is flown here."""

from __future__ import annotations

import importlib
import json
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from visloc_companion.evaluate.real import real_world
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.world import ProceduralWorld, procedural_world
from visloc_companion.sim.flight import Eyes
from visloc_companion.sim.real.programs import Simulator
from visloc_companion.sim.real.scenario import RealScenario
from visloc_companion.sim.real.scenarios import real_scenario
from visloc_companion.sim.vehicles.imu import NOISY
from visloc_companion.sim.vehicles.vehicle_model import ARDUPILOT_SITL, PX4_SIH, Drag
from visloc_companion.types import FrameRef, GeoPoint, LocaliseRequest, PosePrior

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """benchmarks/ is no part of the installed package."""
    monkeypatch.syspath_prepend(str(ROOT))
    return importlib.import_module("benchmarks.autopilots_built_in")


def beside(
    module: ModuleType, monkeypatch: pytest.MonkeyPatch, simulator: Simulator, scenario: RealScenario | None = None, **more: Any
) -> tuple[Any, Eyes]:
    """The built-in autopilot that would fly, and its eyes."""
    flown: list[tuple[Any, Eyes]] = []
    log = SimpleNamespace(entries=[], truth=[])

    def of(pilot: Any, _navigator: Any, _session: Any, eyes: Eyes) -> SimpleNamespace:
        flown.append((pilot, eyes))
        return SimpleNamespace(run=lambda _s: log)

    monkeypatch.setattr(module, "ClosedLoopFlight", of)
    assert module.built_in_p95_m(scenario or real_scenario("jam", simulator), simulator, **more) is None
    return flown[0]


@pytest.mark.parametrize("simulator", Simulator)
def test_the_vehicle_is_the_simulators(module: ModuleType, monkeypatch: pytest.MonkeyPatch, simulator: Simulator) -> None:
    pilot, _ = beside(module, monkeypatch, simulator)
    assert pilot.flight.plan.model == (PX4_SIH if simulator.is_px4 else ARDUPILOT_SITL)
    assert pilot.flight.plan.wind_ned_mps == ((0.0, 0.0, 0.0) if simulator.is_px4 else (2.0, -4.0, 0.0))


def test_the_built_in_vehicle_has_the_flights_drag(module: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = replace(real_scenario("rendered_usual_drag", Simulator.PX4), seen=None)
    pilot, _ = beside(module, monkeypatch, Simulator.PX4, scenario)
    assert pilot.flight.plan.model == replace(PX4_SIH, drag=Drag(0.23))


def test_rendered_frames_are_seen_from_over_their_own_home(
    module: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def small(seed: int) -> ProceduralWorld:
        return procedural_world(seed, tmp_path, size_m=200.0, networks=[])

    monkeypatch.setattr(real_world, "procedural_world", small)
    scenario = real_world.over_its_world(real_scenario("rendered", Simulator.ARDUCOPTER))
    pilot, eyes = beside(module, monkeypatch, Simulator.ARDUCOPTER, scenario)
    assert pilot.flight.plan.home == scenario.home
    assert isinstance(eyes.reference, PackMap)
    assert eyes.camera.render(scenario.home, (1.0, 0.0, 0.0, 0.0), 1).shape == (480, 640, 3)


def test_a_row_of_before_has_ekf2s_own_settings(module: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    pilot, _ = beside(module, monkeypatch, Simulator.PX4_PLANE, ekf2_defaults=True)
    assert pilot.parameters["EKF2_TAU_POS"] == pilot.parameters["EKF2_TAU_VEL"] == 0.25
    assert pilot.flight.plan.model.imu == NOISY


@pytest.mark.parametrize(
    ("options", "expected"),
    [((), {"jam": 2.5, "jump": None, "outages": None}), (("--missing",), {"jam": 1.0, "jump": None, "outages": 2.5})],
)
def test_figures_go_into_the_rows_that_had_one_or_into_the_others(
    module: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    options: tuple[str, ...],
    expected: dict[str, float | None],
) -> None:
    """What cannot be flown beside a row (`jump`) stays without one."""
    page, rows = tmp_path / "page.md", tmp_path / "rows"
    page.write_text("no table")
    rows.mkdir()
    for flight, figure in (("jam", 1.0), ("jump", None), ("outages", None)):
        row = {"simulator": "px4", "flight": flight, "seed": 1, "built_in_p95_m": figure, "error_p95_m": 2.0}
        (rows / f"px4-{flight}-1.json").write_text(json.dumps(row))
    monkeypatch.setattr(module, "ROWS", rows)
    monkeypatch.setattr(module, "DOCS", page)
    monkeypatch.setattr(module, "written", lambda text, _rows: text + ", written")
    monkeypatch.setattr(module, "built_in_p95_m", lambda flown, *_, **__: None if flown.oracle.moved else 1.5 + flown.seed)
    monkeypatch.setattr("sys.argv", ["x", "--write", "--seeds", "2", *options])
    module.main()
    found = {name: json.loads((rows / f"px4-{name}-1.json").read_text())["built_in_p95_m"] for name in expected}
    assert found == expected
    assert page.read_text() == "no table, written"


@pytest.mark.parametrize("flight", ["late", "late_odometry"])
def test_answers_from_the_truth_bring_the_motion_where_the_flights_do(
    module: ModuleType, monkeypatch: pytest.MonkeyPatch, flight: str
) -> None:
    scenario = real_scenario(flight, Simulator.ARDUCOPTER)
    _, eyes = beside(module, monkeypatch, Simulator.ARDUCOPTER, scenario)
    home, level = GeoPoint(59.3, 18.1, 140.0), (1.0, 0.0, 0.0, 0.0)
    motions = []
    for k in range(4):
        place = geo_from_ned((2.5 * k, 0.0, 0.0), home)
        frame = FrameRef(0, k * 250_000_000, k, 0, 640, 480, 3, t_boot_ns=k * 250_000_000)
        request = LocaliseRequest(k, frame, PosePrior(place, level, ((4.0, 0.0), (0.0, 4.0)), 3.0, 0.1, 0.1), 1)
        pixels = eyes.camera.render(place, level, k)
        motions.append(eyes.localiser.localise(request, pixels, eyes.reference).motion)
    if flight == "late":
        assert motions == [None] * 4
        return
    assert motions[0] is None
    assert [motion.displacement_ned_m[0] for motion in motions[1:]] == pytest.approx([2.5, 5.0, 7.5], abs=0.5)
