"""A minute without any fix while the ground is seen: `python -m benchmarks.withheld [--seconds S] [--vehicles ...] ...`.

Whole flights in closed loop over the procedural world of two dates, GNSS jammed after 30 s. From the 75th second on the
localiser's fixes are withheld; what it saw of the camera's motion is not. One row a flight: the way flown meanwhile, the largest
drift and that at the end (error less the one at the beginning) as shares of the way, the largest error, epochs beyond the level
and the largest level, the first fix afterwards, and how far the error moved until two seconds after it, in sigmas stated before.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, cast

import cv2
import numpy as np

from visloc_companion.config import DEFAULT_METHOD
from visloc_companion.errors import Reason
from visloc_companion.evaluate.closed_loop import FlightWorld, FlownScenario, eyes_over, fly_with
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.world import procedural_world
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.sim import faults
from visloc_companion.sim.flight import CLOCK_OFFSET_NS
from visloc_companion.sim.scenarios import Scenario
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.setup import FlightSetup, VehicleKind
from visloc_companion.types import AutopilotKind, Fix, Image, LocaliseRequest, NoFix

JAM_S, FROM_S, AFTER_S = 30.0, 75.0, 25.0
REGAINED_S = 2.0
HEADER = "| flight | way m | drift, most | at the end | error m | beyond level | level m | fix after s | moved sigma | modes |"


class Withholding:
    """A localiser whose fixes are kept back for a while; `motion` and `turn` of its answers are not."""

    def __init__(self, localiser: Localiser, from_s: float, to_s: float) -> None:
        self._localiser, self._from_s, self._to_s = localiser, from_s, to_s
        self._start_ns = CLOCK_OFFSET_NS

    @property
    def method(self) -> str:
        """Of the localiser."""
        return self._localiser.method

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The localiser's answer, or what is left of it."""
        found = self._localiser.localise(request, pixels, ref)
        t_s = (found.t_ns - self._start_ns) * 1e-9
        if isinstance(found, NoFix) or not self._from_s <= t_s < self._to_s:
            return found
        about = (found.t_rx_ns, found.t_ns, found.request_id, found.frame_id, found.method)
        return NoFix(*about, Reason.NO_MATCH, found.elapsed_ms, motion=found.motion, turn=found.turn)


def flown(world: FlightWorld, vehicle: VehicleKind, seed: int, seconds: float, width_px: int, rate_hz: float) -> FlownScenario:
    """One flight."""
    jam = faults.jam(JAM_S)
    scenario = Scenario("withheld", "Fixes are withheld.", FROM_S + seconds + AFTER_S, jam, frame_rate_hz=rate_hz)
    setup = FlightSetup(scenario, world.area(), AutopilotKind.ARDUPILOT, vehicle, seed, width_px=width_px)
    eyes = eyes_over(setup, world, DEFAULT_METHOD)
    return fly_with(setup, replace(eyes, localiser=Withholding(eyes.localiser, FROM_S, FROM_S + seconds), reopen=None))


def figures(one: FlownScenario, seconds: float) -> dict[str, Any]:
    """What is printed."""
    record = one.record
    t_s, off = record.t_s, (record.estimate_ned_m - record.truth_ned_m)[:, :2]
    dark = (t_s >= FROM_S) & (t_s < FROM_S + seconds)
    way_m = float(np.hypot(*np.diff(record.truth_ned_m[dark, :2], axis=0).T).sum())
    drift_m = np.hypot(*(off[dark] - off[dark][0]).T)
    fixes = [f.t_s for f in record.fixes if f.t_s >= FROM_S + seconds]
    first = int(np.searchsorted(t_s, FROM_S + seconds)) - 1
    then = int(np.searchsorted(t_s, FROM_S + seconds + REGAINED_S + 0.5))
    moved = off[then] - off[first]
    sigmas = float(np.sqrt(moved @ np.linalg.solve(record.cov_ne_m2[first], moved)))
    return {
        "way_m": way_m,
        "largest": float(drift_m.max()) / way_m,
        "end": float(drift_m[-1]) / way_m,
        "error_m": float(np.hypot(*off[dark].T).max()),
        "beyond": int((record.error_m[dark] > record.protection_level_m[dark]).sum()),
        "level_m": float(record.protection_level_m[dark].max()),
        "first_fix_s": (fixes[0] - FROM_S - seconds) if fixes else float("nan"),
        "sigmas": sigmas,
        "modes": ", ".join(dict.fromkeys(np.array(record.modes)[dark].tolist())),
    }


def row(name: str, f: dict[str, Any]) -> str:
    """A flight as a row of the table."""
    shares = f"{100 * f['largest']:.1f} % | {100 * f['end']:.1f} % | {f['error_m']:.1f}"
    after = f"{f['first_fix_s']:.1f} | {f['sigmas']:.1f} | {f['modes']}"
    return f"| {name} | {f['way_m']:.0f} | {shares} | {f['beyond']} | {f['level_m']:.0f} | {after} |"


def main(argv: Sequence[str] | None = None) -> None:
    """Fly, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--vehicles", nargs="+", default=["copter", "plane"], choices=["copter", "plane"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--width", type=int, default=640, help="columns of the camera")
    parser.add_argument("--rate", type=float, default=4.0, help="frames a second")
    args = parser.parse_args(argv)
    cv2.setNumThreads(1)
    files = procedural_world(1)
    reference = PackMap.open(files.pack, verify_hashes=False)
    world = FlightWorld(files.pack, reference, Scene.load(files.flight_ortho, files.flight_dsm))
    print(f"{HEADER}\n|{'---|' * (HEADER.count('|') - 1)}", flush=True)
    for vehicle in args.vehicles:
        for seed in args.seeds:
            one = flown(world, cast("VehicleKind", vehicle), seed, args.seconds, args.width, args.rate)
            print(row(f"{vehicle}, seed {seed}", figures(one, args.seconds)), flush=True)


if __name__ == "__main__":
    main()
