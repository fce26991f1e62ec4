"""The navigator in the dark over hills: `python -m benchmarks.terrain_loop [--seconds S] [--seeds N] [--vehicles plane]`.

A vehicle with a rangefinder flies over a map that is a formula (testing/hills.py). GNSS is jammed at 15 s; the localiser knows
the place until 10 s and nothing afterwards. Each flight is flown with terrain and without: how far off is the stated position?
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
from visloc_companion.core.terrain_aiding import METHOD
from visloc_companion.errors import Reason
from visloc_companion.geo.wgs84 import distance_m
from visloc_companion.protocols import ReferenceMap
from visloc_companion.sim import faults
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.flight import ClosedLoopFlight, Eyes, FlightLog
from visloc_companion.sim.rangefinder import Rangefinder
from visloc_companion.sim.render_motion import STILL, Shot
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
SPEED_MPS: dict[str, float] = {"copter": 18.0, "plane": 28.0}
Vehicle = Literal["copter", "plane"]


MODEL = CameraModel(64, 48, 50.0, 50.0, 31.5, 23.5)
HEADER = "| vehicle | seed | terrain | fixes, error m 50/max | stated position off, m 50/95/max | failsafe |"


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


def fly(vehicle: Vehicle, seconds: float, terrain: bool, seed: int = 1) -> FlightLog:
    """One flight; hills, noise and drift are the seed's."""
    hills = HillyMap(HOME, 6000.0, HILLS_M, seed=seed)
    sensor = Rangefinder(lambda place: hills.height_amsl_m(*hills.to_map(place.lat_deg, place.lon_deg)), max_m=REACH_M)
    wind = (2.0, -4.0, 0.0)
    pilot = BuiltInAutopilot(
        AutopilotKind.ARDUPILOT, vehicle, HOME, MISSION, SPEED_MPS[vehicle], seed, faults.jam(JAM_S), wind, rangefinder=sensor
    )
    dark = Darkness(pilot)
    answer = configured_terrain(LocaliserConfig(terrain=True, terrain_sigma_m=1.0), hills)
    eyes = Eyes(dark, dark, hills, 2.0, terrain=answer)  # type: ignore[arg-type]
    return ClosedLoopFlight(pilot, Navigator(settings_for(terrain)), MavlinkSession(SessionSettings()), eyes).run(seconds)


def errors_m(log: FlightLog) -> FloatArray:
    """(N,) how far the stated position is off, every 0.1 s after the jam."""
    start_ns = log.truth[0].t_ns + round(JAM_S * 1e9)
    truth = {sample.t_ns // 50_000_000: sample.place for sample in log.truth if sample.t_ns > start_ns}
    stated = [e.command for e in log.entries if isinstance(e.command, Status)]
    pairs = [(s.place, truth[s.t_ns // 50_000_000]) for s in stated if s.t_ns // 50_000_000 in truth]
    return np.array([distance_m(place, true) for place, true in pairs if place is not None])


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
    args = parser.parse_args()
    print(f"{HEADER}\n|{'---|' * HEADER.count(' | ')}---|", flush=True)
    for vehicle in args.vehicles:
        for seed in range(1, 1 + args.seeds):
            for terrain in (True, False):
                log = fly(vehicle, args.seconds, terrain, seed)
                off = np.array([error for _, error in terrain_fixes(log)] or [np.nan])
                stated = " / ".join(f"{v:.0f}" for v in np.percentile(errors_m(log), [50, 95, 100]))
                fixes = f"{len(off)}: {np.median(off):.1f} / {off.max():.1f}" if terrain else "none"
                yes = "with" if terrain else "without"
                print(f"| {vehicle} | {seed} | {yes} | {fixes} | {stated} | {log.failsafe or 'none'} |", flush=True)


if __name__ == "__main__":
    main()
