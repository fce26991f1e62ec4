"""What frames that arrive late cost in closed loop: flights without GNSS, with and without 300 ms of latency, jitter +- 100 ms.

    python -m benchmarks.camera_time_loop [--seeds 1 2 3 4 5] [--vehicles copter plane] [--speed 20] [--seconds 240]
        [--jam 60] [--json FILE]

The simulated vehicle and autopilot, real MAVLink, the navigator, and instead of pictures a localiser that knows the truth at
the exposure: fixes good to 1 m (a tenth of the frames give none), and turns as noisy as those of rendered frames (benchmarks/
camera_time.py): 0.15, 0.15 and 0.06 degrees, Student's with 4 degrees of freedom. GNSS is jammed from `jam` on.

`stamped`: frames bear the autopilot's time. `late`: they bear their arrival, 300 ms +- 100 ms after the exposure. `late, no
turns`: the same, and nothing tells when they were taken. Error: of the filter's position, horizontally, from the jam on: root
mean square over all flights, 95 % and largest. `grows by`: difference of the root mean squares of the same flights.
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from random import Random
from typing import Any, cast

import numpy as np

from benchmarks.worlds.camera_time_world import HEIGHT_M, WIND_NED_MPS, mission
from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.app.settings import core_settings
from visloc_companion.config import Config, InjectionConfig, LocaliserConfig
from visloc_companion.core.navigator import Navigator
from visloc_companion.errors import Reason
from visloc_companion.evaluate.record import from_entries
from visloc_companion.geo.se3 import normalised, quat_inverse, quat_multiply
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.protocols import ReferenceMap
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.camera import SimulatedCamera
from visloc_companion.sim.faults import FaultSchedule, FramesLate, jam
from visloc_companion.sim.flight import CLOCK_OFFSET_NS, ClosedLoopFlight
from visloc_companion.sim.flight_log import Eyes
from visloc_companion.sim.rendering.render_motion import STILL, Shot
from visloc_companion.types import (
    AutopilotKind,
    CameraModel,
    Command,
    Event,
    Fix,
    FloatArray,
    FrameRef,
    GeoPoint,
    Image,
    LocaliseRequest,
    NoFix,
    Quat,
    Turn,
)

LATENCY_S, JITTER_S, RATE_HZ = 0.3, 0.1, 4.0
TURN_RAD = np.radians([0.15, 0.15, 0.06])
FIX_M, MISSES = 1.0, 0.1
HOME = GeoPoint(48.28, 10.42, 500.0)
CASES = ("stamped", "late", "late, no turns")


class PoseCamera:
    """A camera whose pixels are the bytes of its pose."""

    model = CameraModel(640, 480, 554.0, 554.0, 319.5, 239.5)

    def render(self, place: GeoPoint, q_ned_frd: Quat, frame_id: int, shot: Shot = STILL) -> Image:
        """(56,) bytes."""
        numbers = np.array([place.lat_deg, place.lon_deg, place.h_amsl_m, *q_ned_frd])
        return np.frombuffer(numbers.tobytes(), np.uint8)


class Witness:
    """protocols.Localiser: the truth with noise, and how the camera turned since the frame before."""

    method = "witness"

    def __init__(self, seed: int, turns: bool) -> None:
        self._random, self._rng, self._turns = Random(seed), np.random.default_rng(seed), turns
        self._last: tuple[int, Quat] | None = None

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """A fix, or now and then none."""
        lat_deg, lon_deg, h_amsl_m, w, x, y, z = np.frombuffer(pixels.tobytes(), np.float64).tolist()
        frame, q = request.frame, (w, x, y, z)
        turn = self._turn(frame.t_ns, q) if self._turns else None
        if self._random.random() < MISSES:
            no = NoFix(0, frame.t_ns, request.request_id, frame.frame_id, self.method, Reason.NO_MATCH, 50.0)
            return replace(no, turn=turn)
        noise = (self._random.gauss(0, FIX_M), self._random.gauss(0, FIX_M), 0.0)
        place = geo_from_ned(noise, GeoPoint(lat_deg, lon_deg, h_amsl_m))
        cov = ((FIX_M**2, 0.0), (0.0, FIX_M**2))
        ids = (request.request_id, frame.frame_id)
        return Fix(0, frame.t_ns, *ids, self.method, place, q, cov, 2.0, 0.02, 1e-3, 50.0, turn=turn)

    def _turn(self, t_ns: int, q: Quat) -> Turn | None:
        last, self._last = self._last, (t_ns, q)
        if last is None or not 0 < t_ns - last[0] <= 1_000_000_000:
            return None
        off = self._rng.standard_t(4, 3) * TURN_RAD / math.sqrt(2)
        small = normalised((1.0, float(off[0]) / 2, float(off[1]) / 2, float(off[2]) / 2))
        (a, b, c) = (float(v) for v in TURN_RAD**2)
        return Turn(
            last[0], t_ns, quat_multiply(quat_multiply(quat_inverse(last[1]), q), small), ((a, 0, 0), (0, b, 0), (0, 0, c))
        )


class Unstamped:
    """A navigator whose frames bear the time of their arrival."""

    def __init__(self, navigator: Navigator) -> None:
        self._navigator = navigator

    def on(self, event: Event, now_ns: int) -> list[Command]:
        """As protocols.NavigatorLike."""
        if isinstance(event, FrameRef):
            event = replace(event, t_ns=event.t_rx_ns, t_boot_ns=None)
        return self._navigator.on(event, now_ns)


@dataclass(frozen=True, slots=True)
class Conditions:
    """How to fly."""

    vehicle: str
    speed_mps: float
    seconds: float
    jam_s: float


def flown(how: Conditions, case: str, seed: int) -> FloatArray:
    """(N,) horizontal errors of the filter from the jam on, ten a second."""
    faults = jam(how.jam_s)
    if case != "stamped":
        faults += FaultSchedule((FramesLate(0.0, LATENCY_S - JITTER_S, 2 * JITTER_S),))
    way, kind = mission(HEIGHT_M[how.vehicle]), "plane" if how.vehicle == "plane" else "copter"
    pilot = BuiltInAutopilot(AutopilotKind.ARDUPILOT, kind, HOME, way, how.speed_mps, seed, faults, WIND_NED_MPS)
    config = Config(injection=InjectionConfig(switch_source=True), localiser=LocaliserConfig(max_rate_hz=RATE_HZ), seed=seed)
    navigator = Navigator(core_settings(config))
    heard = navigator if case == "stamped" else cast("Navigator", Unstamped(navigator))
    witness = Witness(seed, case != "late, no turns")
    eyes = Eyes(cast("SimulatedCamera", PoseCamera()), witness, cast("ReferenceMap", None), RATE_HZ)
    flight = ClosedLoopFlight(pilot, heard, MavlinkSession(SessionSettings()), eyes)
    log = flight.run(how.seconds)
    record = from_entries(log.entries, log.truth, t0_ns=CLOCK_OFFSET_NS)
    error = np.asarray(record.error_m[record.t_s >= how.jam_s], dtype=np.float64)
    return np.where(np.isfinite(error), error, np.inf) if len(error) else np.full(1, np.inf)


def figures(errors: list[FloatArray], against: list[FloatArray]) -> dict[str, float]:
    """Of one case."""
    every, base = np.concatenate(errors), np.concatenate(against)
    return {
        "flights": len(errors),
        "rms_m": _rms(every),
        "p95_m": float(np.percentile(every, 95)),
        "max_m": float(every.max()),
        "grows_by_m": _rms(every) - _rms(base),
        "worst_flight_m": max(_rms(a) - _rms(b) for a, b in zip(errors, against, strict=True)),
    }


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3, 4, 5])
    parser.add_argument("--vehicles", nargs="+", default=["copter", "plane"])
    parser.add_argument("--speed", type=float, default=20.0)
    parser.add_argument("--seconds", type=float, default=240.0)
    parser.add_argument("--jam", type=float, default=60.0)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    print(
        "| vehicle | frames | flights | error rms | 95 % | largest | grows by | worst flight |\n|---|---|---|---|---|---|---|---|"
    )
    for vehicle in options.vehicles:
        how = Conditions(vehicle, options.speed, options.seconds, options.jam)
        errors = {}
        for case in CASES:
            errors[case] = [flown(how, case, seed) for seed in options.seeds]
            row = {"vehicle": vehicle, "frames": case, **figures(errors[case], errors["stamped"])}
            rows.append(row)
            numbers = " | ".join(f"{row[name]:.2f} m" for name in ("rms_m", "p95_m", "max_m", "grows_by_m", "worst_flight_m"))
            print(f"| {vehicle} | {case} | {row['flights']} | {numbers} |", flush=True)
    if options.json:
        text = json.dumps({"schema": 1, "seeds": options.seeds, "rows": rows}, indent=1, allow_nan=False)
        options.json.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
