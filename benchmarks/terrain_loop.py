"""The navigator in the dark over hills: `python -m benchmarks.terrain_loop [--seconds S] [--seeds N] [--vehicles plane]`.

A vehicle with a rangefinder flies over a map that is a formula (testing/hills.py). GNSS is jammed at 15 s; the localiser knows
the place until 10 s and nothing afterwards. Each flight is flown with terrain and without: how far off is the stated position, in
its own sigmas, and how often beyond its protection level?
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import Literal

import numpy as np

from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.app.terrain import configured_terrain
from visloc_companion.config import LocaliserConfig
from visloc_companion.core.navigator import Navigator
from visloc_companion.core.settings import CoreSettings, InjectionSettings, NavigatorSettings
from visloc_companion.core.terrain.terrain_aiding import METHOD
from visloc_companion.errors import Reason
from visloc_companion.geo.wgs84 import distance_m
from visloc_companion.protocols import ReferenceMap
from visloc_companion.sim import faults
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.flight import ClosedLoopFlight, Eyes, FlightLog
from visloc_companion.sim.rendering.render_motion import STILL, Shot
from visloc_companion.sim.vehicles.rangefinder import Rangefinder
from visloc_companion.testing.hills import HillyMap
from visloc_companion.types import (
    AutopilotKind,
    CameraModel,
    Fix,
    FloatArray,
    GeoPoint,
    Image,
    LocaliseRequest,
    NoFix,
    Quat,
    Status,
)

HOME = GeoPoint(47.4, 8.55, 480.0)
MISSION = ((-3500.0, -1500.0, -300.0), (3500.0, -1500.0, -300.0), (3500.0, 1500.0, -300.0), (-3500.0, 1500.0, -300.0))
DUSK_S, JAM_S = 10.0, 15.0
HILLS_M, REACH_M, LOST_SIGMA_M = 80.0, 600.0, 150.0
MODEL_SEED = 1000
SPEED_MPS: dict[str, float] = {"copter": 18.0, "plane": 28.0}
Vehicle = Literal["copter", "plane"]


MODEL = CameraModel(64, 48, 50.0, 50.0, 31.5, 23.5)
HEADER = (
    "| vehicle | seed | terrain | fixes, error m 50/max | stated position off, m 50/95/max | off over sigma, rms/max | "
    "beyond its level | failsafe |"
)


@dataclass(slots=True)
class Darkness:
    """A camera and a localiser that knows the place until dusk, and then nothing."""

    pilot: BuiltInAutopilot
    model: CameraModel = MODEL
    method: str = "eye"

    def render(self, place: GeoPoint, q_ned_frd: Quat, frame_id: int, shot: Shot = STILL) -> Image:
        """Black."""
        return np.zeros((48, 64), np.uint8)

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The truth while there is light."""
        frame, truth = request.frame, self.pilot.truth()
        about = (frame.t_rx_ns, frame.t_ns, request.request_id, frame.frame_id, self.method)
        if self.pilot.t_s > DUSK_S:
            return NoFix(*about, Reason.LOW_TEXTURE, 1.0)
        return Fix(*about, truth.place, truth.q_ned_frd, ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.1, 1e-3, 1.0)


def settings_for(terrain: bool) -> CoreSettings:
    """What the navigator is told."""
    navigator = NavigatorSettings(lost_sigma_m=LOST_SIGMA_M)
    return CoreSettings(navigator=navigator, injection=InjectionSettings(switch_source=True), terrain=terrain)


def fly(
    vehicle: Vehicle, seconds: float, terrain: bool, seed: int = 1, hills_m: float = HILLS_M, model_error_m: float = 0.0
) -> FlightLog:
    """One flight over hills of a 1-sigma height, from which the map differs by another; they and the noise are the seed's."""
    hills = HillyMap(HOME, 6000.0, hills_m, seed=seed)
    error = HillyMap(HOME, 6000.0, model_error_m, seed=seed + MODEL_SEED)

    def ground_amsl_m(place: GeoPoint) -> float:
        at = hills.to_map(place.lat_deg, place.lon_deg)
        return hills.height_amsl_m(*at) + error.height_amsl_m(*at) - HOME.h_amsl_m

    sensor = Rangefinder(ground_amsl_m, max_m=REACH_M)
    wind = (2.0, -4.0, 0.0)
    pilot = BuiltInAutopilot(
        AutopilotKind.ARDUPILOT, vehicle, HOME, MISSION, SPEED_MPS[vehicle], seed, faults.jam(JAM_S), wind, rangefinder=sensor
    )
    dark = Darkness(pilot)
    answer = configured_terrain(LocaliserConfig(terrain=True, terrain_sigma_m=max(1.0, model_error_m)), hills)
    eyes = Eyes(dark, dark, hills, 2.0, terrain=answer)  # type: ignore[arg-type]
    return ClosedLoopFlight(pilot, Navigator(settings_for(terrain)), MavlinkSession(SessionSettings()), eyes).run(seconds)


def stated(log: FlightLog) -> list[tuple[Status, GeoPoint]]:
    """What was stated every 0.1 s after the jam, each with the true place."""
    start_ns = log.truth[0].t_ns + round(JAM_S * 1e9)
    truth = {sample.t_ns // 50_000_000: sample.place for sample in log.truth if sample.t_ns > start_ns}
    every = [e.command for e in log.entries if isinstance(e.command, Status) and e.command.place is not None]
    return [(status, truth[status.t_ns // 50_000_000]) for status in every if status.t_ns // 50_000_000 in truth]


def errors_m(log: FlightLog) -> FloatArray:
    """(N,) how far the stated position is off, every 0.1 s after the jam."""
    return np.array([distance_m(status.place, true) for status, true in stated(log) if status.place is not None])


def claimed(log: FlightLog) -> tuple[FloatArray, FloatArray]:
    """(N,) these errors over the stated sigma, per axis, and (N,) the protection level beside them, infinite where none is."""
    sigmas = [np.sqrt(np.trace(np.array(status.cov_ne_m2))) for status, _ in stated(log)]
    levels = [np.inf if status.protection_level_m is None else status.protection_level_m for status, _ in stated(log)]
    return errors_m(log) / np.array(sigmas), np.array(levels)


def terrain_fixes(log: FlightLog) -> list[tuple[Fix, float]]:
    """The fixes of the terrain, each with its error, m."""
    truth = {sample.t_ns // 100_000_000: sample.place for sample in log.truth}
    fixes = [e.event for e in log.entries if isinstance(e.event, Fix) and e.event.method == METHOD]
    return [(fix, distance_m(fix.place, truth[fix.t_ns // 100_000_000])) for fix in fixes]


def main() -> None:
    """Fly with and without, print a line each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--vehicles", nargs="*", choices=list(SPEED_MPS), default=list(SPEED_MPS))
    parser.add_argument("--hills", type=float, default=HILLS_M, help="1-sigma of their height, m")
    parser.add_argument("--model-error", type=float, default=0.0, help="1-sigma by which the map differs from the ground, m")
    parser.add_argument("--only-with", action="store_true", help="no flights without terrain")
    args = parser.parse_args()
    print(f"{HEADER}\n|{'---|' * HEADER.count(' | ')}---|", flush=True)
    for vehicle in args.vehicles:
        for seed in range(1, 1 + args.seeds):
            for terrain in (True,) if args.only_with else (True, False):
                log = fly(vehicle, args.seconds, terrain, seed, args.hills, args.model_error)
                off = np.array([error for _, error in terrain_fixes(log)] or [np.nan])
                off_m = errors_m(log)
                over, levels_m = claimed(log)
                quantiles = " / ".join(f"{v:.0f}" for v in np.percentile(off_m, [50, 95, 100]))
                beyond = f"{np.count_nonzero(off_m > levels_m)} of {len(off_m)}"
                ratio = f"{np.sqrt(np.mean(np.square(over))):.2f} / {over.max():.2f} | {beyond}"
                fixes = f"{len(off)}: {np.median(off):.1f} / {off.max():.1f}" if terrain else "none"
                yes = "with" if terrain else "without"
                row = f"| {vehicle} | {seed} | {yes} | {fixes} | {quantiles} | {ratio} | {log.failsafe or 'none'} |"
                print(row, flush=True)


if __name__ == "__main__":
    main()
