"""The built-in autopilot on the circuits of the real simulators, with the same fixes: what stands beside them in the table.

`python -m benchmarks.autopilots_built_in [--missing] [--seeds S ...] [--write]` flies it for every row that has a figure, with
`--missing` for those that have none, prints 95 % of its error for each seed, and with `--write` puts those of the rows' own seeds
into the rows and docs/autopilots.md. `--alone arducopter/rendered` flies what has no row.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace
from random import Random
from typing import cast

import numpy as np

from benchmarks.pages.autopilots_table import DOCS, ROWS, Row, read_rows, row_path, written
from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.app.settings import core_settings
from visloc_companion.config import Config
from visloc_companion.core.navigator import Navigator
from visloc_companion.errors import Reason
from visloc_companion.evaluate.real.real_world import over_its_world
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.protocols import ReferenceMap
from visloc_companion.sim import faults
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.camera import SimulatedCamera
from visloc_companion.sim.faults import FaultSchedule
from visloc_companion.sim.faults.camera import FramesLate
from visloc_companion.sim.flight import CLOCK_OFFSET_NS, ClosedLoopFlight, Eyes
from visloc_companion.sim.real.lives import flight_config
from visloc_companion.sim.real.oracle import HEIGHT_SIGMA_M, METHOD, MotionSeen, OracleSettings, answered_height
from visloc_companion.sim.real.programs import Simulator
from visloc_companion.sim.real.rendered import opened
from visloc_companion.sim.real.scenario import RealScenario
from visloc_companion.sim.real.scenarios import real_scenario
from visloc_companion.sim.vehicles.imu import NOISY
from visloc_companion.sim.vehicles.vehicle_model import ARDUPILOT_SITL, PX4_SIH, Drag, VehicleModel
from visloc_companion.types import AutopilotKind, EkfSource, Fix, GeoPoint, Image, LocaliseRequest, NoFix, Quat, SourceSwitched

WIND_NED_MPS, CALM = (2.0, -4.0, 0.0), (0.0, 0.0, 0.0)
BOOT_AGE_S = 60.0
EKF2_DEFAULT_TAUS = {"EKF2_TAU_POS": 0.25, "EKF2_TAU_VEL": 0.25}


def built_in_p95_m(scenario: RealScenario, simulator: Simulator, *, ekf2_defaults: bool = False) -> float | None:
    """95 % of the built-in autopilot's own error while it flies on vision, metres.

    None where it never does, and for flights that it cannot fly: with restarts, jumps, or no GNSS at boot.
    `ekf2_defaults`: with EKF2's own time constants and noise of the accelerometers, as before decision 25.
    """
    if scenario.restarts or scenario.oracle.moved or not scenario.gnss_at_boot:
        return None
    kind = AutopilotKind.PX4 if simulator.is_px4 else AutopilotKind.ARDUPILOT
    route = scenario.route
    pilot = BuiltInAutopilot(
        kind,
        "plane" if simulator.is_plane else "copter",
        scenario.home,
        [(leg.north_m, leg.east_m, -route.height_m) for leg in route.legs],
        route.speed_mps,
        scenario.seed,
        _faults(scenario),
        CALM if simulator.is_px4 else WIND_NED_MPS,
        boot_age_s=BOOT_AGE_S,
        model=_model(scenario, simulator, ekf2_defaults),
        parameters=EKF2_DEFAULT_TAUS if ekf2_defaults else None,
    )
    config = flight_config(scenario)
    log = ClosedLoopFlight(
        pilot, Navigator(core_settings(config)), MavlinkSession(SessionSettings()), _eyes(scenario, config)
    ).run(scenario.duration_s)
    switches = [(e.now_ns, e.event.source) for e in log.entries if isinstance(e.event, SourceSwitched) and e.event.accepted]
    errors = [sample.off_m for sample in log.truth if _on_vision(switches, sample.t_ns) and sample.off_m is not None]
    return float(np.percentile(errors, 95)) if errors else None


def main() -> None:
    """Fly the rows' flights."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="*", default=[], help="further seeds, to see what is chance")
    parser.add_argument("--flights", nargs="*", help="only these")
    parser.add_argument("--missing", action="store_true", help="for rows that have no figure yet")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--alone", nargs="*", default=[], metavar="SIMULATOR/FLIGHT", help="these, and no row's")
    args = parser.parse_args()
    for simulator, _, flight in (name.partition("/") for name in args.alone):
        for seed in args.seeds or [1]:
            row = {"simulator": simulator, "flight": flight}
            print(f"{simulator} {flight}, seed {seed}: {_figure(row, seed)}", flush=True)
    if args.alone:
        return
    for row in read_rows(ROWS):
        if (row.get("built_in_p95_m") is None) != args.missing or (args.flights and row["flight"] not in args.flights):
            continue
        figures = {seed: _figure(row, seed) for seed in dict.fromkeys([row["seed"], *args.seeds])}
        shown = ", ".join(f"{figure:.2f} (seed {seed})" for seed, figure in figures.items() if figure is not None)
        if not shown:
            continue
        print(f"{row['simulator']} {row['flight']}: {shown}; the real one {row['error_p95_m']:.2f}", flush=True)
        if args.write:
            path = row_path(ROWS, Simulator(row["simulator"]), row["flight"], row["seed"])
            path.write_text(json.dumps({**row, "built_in_p95_m": figures[row["seed"]]}, indent=1), encoding="utf-8")
    if args.write:
        DOCS.write_text(written(DOCS.read_text(encoding="utf-8"), read_rows(ROWS)), encoding="utf-8")


def _model(scenario: RealScenario, simulator: Simulator, ekf2_defaults: bool) -> VehicleModel:
    if not simulator.is_px4:
        return ARDUPILOT_SITL
    model = replace(PX4_SIH, imu=NOISY) if ekf2_defaults else PX4_SIH
    return model if scenario.drag_per_s is None else replace(model, drag=Drag(scenario.drag_per_s))


def _figure(row: Row, seed: int) -> float | None:
    simulator = Simulator(row["simulator"])
    scenario = over_its_world(real_scenario(row["flight"], simulator, seed))
    return built_in_p95_m(scenario, simulator, ekf2_defaults=row.get("ekf2_defaults", False))


def _eyes(scenario: RealScenario, config: Config) -> Eyes:
    oracle = scenario.oracle
    latency_s = oracle.latency_s + oracle.jitter_s / 2
    if scenario.seen is not None:
        camera, localiser, reference = opened(scenario.seen, config)
        return Eyes(camera, localiser, reference, oracle.frames_hz, latency_s)
    poses = (
        cast(SimulatedCamera, _PoseCamera()),
        _PoseReader(oracle, scenario.seed, scenario.home.h_amsl_m),
        cast(ReferenceMap, None),
    )
    return Eyes(*poses, oracle.frames_hz, latency_s)


def _on_vision(switches: list[tuple[int, EkfSource]], t_ns: int) -> bool:
    before = [source for at_ns, source in switches if at_ns <= t_ns]
    return bool(before) and before[-1] is EkfSource.VISION and t_ns > CLOCK_OFFSET_NS


def _faults(scenario: RealScenario) -> FaultSchedule:
    schedule = FaultSchedule()
    if scenario.jam_at_s is not None:
        end_s = float("inf") if scenario.gnss_back_at_s is None else scenario.gnss_back_at_s
        schedule += faults.jam(scenario.jam_at_s, end_s)
    if scenario.oracle.frame_delay_s:
        schedule += faults.these(FramesLate(0.0, scenario.oracle.frame_delay_s, 0.0))
    if scenario.drag_at_s is not None:
        north, east = scenario.drag_mps
        schedule += faults.slow_drag(
            scenario.drag_at_s, float(np.hypot(north, east)), float(np.arctan2(east, north)), consistent_velocity=False
        )
    return schedule


class _PoseCamera:
    """Pixels that hold nothing but the pose from which they were taken."""

    @property
    def model(self) -> _Size:
        return _Size()

    def render(self, place: GeoPoint, q_ned_frd: Quat, *_: object) -> Image:
        return np.frombuffer(np.array([place.lat_deg, place.lon_deg, place.h_amsl_m, *q_ned_frd]).tobytes(), np.uint8)


@dataclass(frozen=True, slots=True)
class _Size:
    width_px: int = 640
    height_px: int = 480


class _PoseReader:
    """Answers with the pose in the pixels and the noise of the real flights."""

    method = METHOD

    def __init__(self, settings: OracleSettings, seed: int, ground_amsl_m: float) -> None:
        self._settings, self._rng = settings, Random(f"{seed}/oracle")
        self._motion = MotionSeen(seed, ground_amsl_m) if settings.odometry else None
        self._asked = 0

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        lat, lon, height, w, x, y, z = np.frombuffer(pixels.tobytes(), np.float64).tolist()
        flight_s, frame = (request.frame.t_boot_ns or 0) * 1e-9 - BOOT_AGE_S, request.frame
        ids = request.request_id, frame.frame_id
        if not self._settings.sees(flight_s):
            if self._motion is not None:
                self._motion.lose()
            return NoFix(0, frame.t_ns, *ids, METHOD, Reason.NO_MATCH, 0.0)
        motion = None if self._motion is None else self._motion.look(frame.t_ns, GeoPoint(lat, lon, height), request.believed)
        self._asked += 1
        if self._asked % self._settings.recognised_of:
            return NoFix(0, frame.t_ns, *ids, METHOD, Reason.NO_MATCH, 0.0, motion=motion)
        sigma, claimed = self._settings.sigma_m, self._settings.claimed_sigma_m**2
        noise = self._rng.gauss(0.0, sigma), self._rng.gauss(0.0, sigma), self._rng.gauss(0.0, HEIGHT_SIGMA_M)
        place = geo_from_ned(noise, GeoPoint(lat, lon, height))
        h_m, sigma_h_m = answered_height(place.h_amsl_m, request.prior)
        place = replace(place, h_amsl_m=h_m)
        cov = ((claimed, 0.0), (0.0, claimed))
        return Fix(0, frame.t_ns, *ids, METHOD, place, (w, x, y, z), cov, sigma_h_m, 0.01, 1e-4, 50.0, motion=motion)


if __name__ == "__main__":
    main()
