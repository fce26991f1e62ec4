"""A minute without any fix, with and without a rangefinder: `python -m benchmarks.ranged [--flights copter plane ...] ...`.

Whole flights in closed loop over rendered pictures, GNSS jammed after 12 s. Odometry is the daemon's own. In the localiser's
place is one that knows the place to 1 m and the height to a constant 0.7 m (drawn for each flight) and 0.5 m, which sees nothing
from the 40th second on. Each flight twice, with the same seed: its odometry without and with the heights of a rangefinder. That
one measures along the vehicle's down axis to the surface that the camera sees (crowns and roofs of the flight's date, which the
map's surface model of another date has otherwise); its reach is 400 m, its constant errors are drawn for each flight (0.1 m and
0.5 % of the distance, 1-sigma), as is its noise (0.1 m and 0.1 %).

`copter` and `plane` fly the ordinary course at 10 and 25 m/s, 120 m up; `leaning` is a copter 60 m up at 20 m/s, which leans by
some 25 degrees against its drag. `drifting`: a copter whose barometer goes wrong by 8 m in the minute. `flat`: a copter over a
pack without heights, above land that has them: its fixes have the ground that they see on the pack's plane, as real ones have.

Of the minute, one row a flight and one over all of a kind (root mean squares, of NEES the mean): by how much odometry's
displacements were too long, all answers together; drift of the position, the largest and at the end, as shares of the way; 95 %
of the errors; NEES of the position (mean, 2 where claims are right); epochs beyond the level, and the largest level.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from random import Random

import cv2
import numpy as np

from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.app.settings import core_settings
from visloc_companion.core.navigator import Navigator
from visloc_companion.errors import Reason
from visloc_companion.evaluate.closed_loop import FlightWorld, simulated_config
from visloc_companion.evaluate.record import FlightRecord, from_entries
from visloc_companion.geo.raster import apply_affine, invert_affine
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.localise.around.map_shape import OverPlane
from visloc_companion.localise.around.with_motion import WithMotion
from visloc_companion.localise.around.with_turn import WithTurn
from visloc_companion.localise.odometry.surface_window import SurfaceWindow
from visloc_companion.localise.odometry.true_heading import TrueHeading
from visloc_companion.maps.grid import Heights
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.world import procedural_world
from visloc_companion.protocols import ReferenceMap
from visloc_companion.sim import faults
from visloc_companion.sim.flight import CLOCK_OFFSET_NS, ClosedLoopFlight, Eyes, FlightLog
from visloc_companion.sim.rendering.render_motion import STILL, Shot
from visloc_companion.sim.scenarios import Scenario
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.seen import SimulatedCamera, simulated_camera
from visloc_companion.sim.setup import FlightSetup, VehicleKind
from visloc_companion.sim.vehicles.rangefinder import Rangefinder
from visloc_companion.types import AutopilotKind, CameraModel, Fix, GeoPoint, Image, LocaliseRequest, NoFix, Quat

FLIGHTS = ("copter", "plane", "leaning", "drifting", "flat")
JAM_S, FROM_S = 12.0, 40.0
FIX_SIGMA_M, FIX_BIAS_H_M, FIX_SIGMA_H_M = 1.0, 0.7, 0.5
LEANING_MPS, LEANING_M = 20.0, 60.0
DRIFT_M = 8.0
SEEN_M = 45.0
"""Of the ground, to each side, by a camera 120 m above it."""
BIAS_M, BIAS_SHARE = 0.1, 0.005
COLUMNS = "way m | odometry too long | drift, most | at the end | error m, 95 % | NEES | beyond level | level m"
HEADER = f"| flight | seed | rangefinder | {COLUMNS} |"


def pixel_of(place: GeoPoint, scene: Scene) -> tuple[int, int]:
    """Column and row of a scene's pixel below a place."""
    u, v = apply_affine(invert_affine(scene.T_map_pix), np.array(scene.projection_at(place).origin_map_m)).tolist()
    return round(u), round(v)


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """The plane of a pack without heights, below or above what the camera sees."""

    scene: Scene
    h_amsl_m: float

    def above_m(self, place: GeoPoint) -> float:
        """By how much the plane is higher than the ground within SEEN_M of a place, on average."""
        reach = round(SEEN_M / float(np.hypot(*self.scene.T_map_pix[:, 0])))
        col, row = (max(0, at - reach) for at in pixel_of(place, self.scene))
        seen = self.scene.dsm_amsl_m[row : row + 2 * reach, col : col + 2 * reach]
        return self.h_amsl_m - float(seen.mean())


class Knowing:
    """The camera of a flight, and in the localiser's place one that remembers where frames were taken, until fixes end."""

    method = "knowing"

    def __init__(self, camera: SimulatedCamera, seed: int, until_s: float, plane: Plane | None = None) -> None:
        self._plane = plane
        self._camera, self._until_ns = camera, CLOCK_OFFSET_NS + round(until_s * 1e9)
        self._rng = Random(f"{seed}/fixes")
        self._too_high_m = self._rng.gauss(0.0, FIX_BIAS_H_M)
        self._taken: dict[int, tuple[GeoPoint, Quat]] = {}

    @property
    def model(self) -> CameraModel:
        """Of the camera."""
        return self._camera.model

    def render(self, place: GeoPoint, q_ned_frd: Quat, frame_id: int, shot: Shot = STILL) -> Image:
        """A picture."""
        self._taken[frame_id] = place, q_ned_frd
        return self._camera.render(place, q_ned_frd, frame_id, shot)

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The truth with its errors."""
        frame, rng = request.frame, self._rng
        about = (frame.t_rx_ns, frame.t_ns, request.request_id, frame.frame_id, self.method)
        if frame.t_ns > self._until_ns:
            return NoFix(*about, Reason.NO_MATCH, 1.0)
        place, q_ned_frd = self._taken[frame.frame_id]
        seen_as_m = 0.0 if self._plane is None else self._plane.above_m(place)
        down_m = -seen_as_m - self._too_high_m - rng.gauss(0.0, FIX_SIGMA_H_M)
        place = geo_from_ned((rng.gauss(0.0, FIX_SIGMA_M), rng.gauss(0.0, FIX_SIGMA_M), down_m), place)
        cov = ((FIX_SIGMA_M**2, 0.0), (0.0, FIX_SIGMA_M**2))
        sigma_h_m = math.hypot(FIX_BIAS_H_M, FIX_SIGMA_H_M)
        return Fix(*about, place, q_ned_frd, cov, sigma_h_m, math.radians(1.0), 1e-4, 1.0)


def sensor_over(scene: Scene, seed: int, max_m: float) -> Rangefinder:
    """A rangefinder over what the camera sees, with the constant errors of a seed."""
    rng = Random(f"{seed}/range bias")
    off_m, off_share = rng.gauss(0.0, BIAS_M), rng.gauss(0.0, BIAS_SHARE)
    lowest_m = float(np.nanmin(scene.dsm_amsl_m))
    height, width = scene.dsm_amsl_m.shape

    def surface(place: GeoPoint) -> float:
        col, row = pixel_of(place, scene)
        if not (0 <= col < width and 0 <= row < height):
            return math.nan
        return float(scene.dsm_amsl_m[row, col])

    def as_measured(place: GeoPoint) -> float:
        return surface(place) - off_m - off_share * (place.h_amsl_m - lowest_m)

    return Rangefinder(as_measured, max_m=max_m)


def over_plane(world: FlightWorld) -> FlightWorld:
    """The world with a map whose ground is the plane of home's height."""
    known = world.reference
    plane = Heights(None, known._crs, world.area().home.h_amsl_m)
    return replace(world, reference=PackMap(known.manifest, known._crs, known._pixels, plane, known.stored, None))


def flown(
    world: FlightWorld, flight: str, seed: int, sensor: Rangefinder | None, seconds: float, width_px: int, rate_hz: float
) -> FlightLog:
    """One flight."""
    vehicle: VehicleKind = "plane" if flight == "plane" else "copter"
    wrong = faults.jam(JAM_S)
    if flight == "drifting":
        wrong += faults.these(faults.BaroDrift(FROM_S, DRIFT_M, seconds))
    height_m = LEANING_M if flight == "leaning" else None
    scenario = Scenario("ranged", "Fixes are withheld.", FROM_S + seconds, wrong, frame_rate_hz=rate_hz, height_m=height_m)
    setup = FlightSetup(
        scenario,
        world.area(),
        AutopilotKind.ARDUPILOT,
        vehicle,
        seed,
        width_px=width_px,
        rangefinder=sensor,
        speed_mps=LEANING_MPS if flight == "leaning" else None,
    )
    plane = Plane(world.scene, setup.area.home.h_amsl_m) if flight == "flat" else None
    knowing, window = Knowing(simulated_camera(setup, world.scene), seed, FROM_S, plane), SurfaceWindow()
    model, heading = knowing.model, TrueHeading()
    moving = WithMotion(knowing, model, window=window, heading=heading)
    localiser = OverPlane(WithTurn(moving, model, window, heading))
    eyes = Eyes(knowing, localiser, world.reference, rate_hz)  # type: ignore[arg-type]
    navigator = Navigator(core_settings(simulated_config(setup)))
    return ClosedLoopFlight(setup.autopilot(), navigator, MavlinkSession(SessionSettings()), eyes).run(FROM_S + seconds)


def too_long(log: FlightLog, record: FlightRecord) -> float:
    """By which share displacements without fixes were too long, each along the true way between its two times."""
    seen_m = true_m = 0.0
    for entry in log.entries:
        motion = entry.event.motion if isinstance(entry.event, NoFix) else None
        if motion is None:
            continue
        t_s = (np.array([motion.t_from_ns, motion.t_to_ns]) - CLOCK_OFFSET_NS) * 1e-9
        if t_s[0] < FROM_S:
            continue
        true = np.array([np.diff(np.interp(t_s, record.t_s, record.truth_ned_m[:, k]))[0] for k in (0, 1)])
        seen_m += math.hypot(*motion.displacement_ned_m[:2])
        true_m += float(np.hypot(*true))
    return seen_m / true_m - 1


def figures(log: FlightLog, seconds: float) -> dict[str, float]:
    """Of the minute without fixes."""
    record = from_entries(log.entries, log.truth, t0_ns=CLOCK_OFFSET_NS)
    dark = (record.t_s >= FROM_S) & (record.t_s < FROM_S + seconds)
    off = (record.estimate_ned_m - record.truth_ned_m)[dark, :2]
    way_m = float(np.hypot(*np.diff(record.truth_ned_m[dark, :2], axis=0).T).sum())
    drift_m, error_m = np.hypot(*(off - off[0]).T), np.hypot(*off.T)
    return {
        "way_m": way_m,
        "along": too_long(log, record),
        "most": float(drift_m.max()) / way_m,
        "end": float(drift_m[-1]) / way_m,
        "error95_m": float(np.percentile(error_m, 95)),
        "nees": float(np.mean([e @ np.linalg.solve(P, e) for e, P in zip(off, record.cov_ne_m2[dark], strict=True)])),
        "beyond": float((record.error_m[dark] > record.protection_level_m[dark]).sum()),
        "level_m": float(record.protection_level_m[dark].max()),
    }


def row(name: str, f: dict[str, float]) -> str:
    """A flight, or the root mean squares over several, as a row of the table."""
    shares = (
        f"{100 * f['along']:+.2f} % | {100 * f['most']:.2f} % | {100 * f['end']:.2f} % | {f['error95_m']:.2f} | {f['nees']:.2f}"
    )
    return f"| {name} | {f['way_m']:.0f} | {shares} | {f['beyond']:.0f} | {f['level_m']:.0f} |"


def over_all(some: list[dict[str, float]]) -> dict[str, float]:
    """Root mean squares, of NEES the mean, of epochs the sum, of levels the largest."""
    mean = {name: math.sqrt(sum(f[name] ** 2 for f in some) / len(some)) for name in some[0]}
    return mean | {
        "nees": sum(f["nees"] for f in some) / len(some),
        "beyond": sum(f["beyond"] for f in some),
        "level_m": max(f["level_m"] for f in some),
    }


def main(argv: Sequence[str] | None = None) -> None:
    """Fly, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", nargs="+", default=list(FLIGHTS), choices=FLIGHTS)
    parser.add_argument("--seeds", nargs="+", type=int, default=[11, 12, 13])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--reach", type=float, default=400.0, help="of the rangefinder, m")
    parser.add_argument("--world", type=int, default=1, help="seed of the landscape")
    parser.add_argument("--width", type=int, default=320, help="columns of the camera")
    parser.add_argument("--rate", type=float, default=2.0, help="frames a second")
    args = parser.parse_args(argv)
    cv2.setNumThreads(1)
    files = procedural_world(args.world)
    scene = Scene.load(files.flight_ortho, files.flight_dsm)
    world = FlightWorld(files.pack, PackMap.open(files.pack, verify_hashes=False), scene)
    print(f"{HEADER}\n|{'---|' * (HEADER.count('|') - 1)}", flush=True)
    for flight in args.flights:
        found: dict[str, list[dict[str, float]]] = {"without": [], "with": []}
        over = over_plane(world) if flight == "flat" else world
        for seed in args.seeds:
            for how, rows in found.items():
                sensor = sensor_over(scene, seed, args.reach) if how == "with" else None
                one = flown(over, flight, seed, sensor, args.seconds, args.width, args.rate)
                rows.append(figures(one, args.seconds))
                print(row(f"{flight} | {seed} | {how}", rows[-1]), flush=True)
        for how, rows in found.items():
            print(row(f"{flight} | {len(rows)} flights | {how}", over_all(rows)), flush=True)


if __name__ == "__main__":
    main()
