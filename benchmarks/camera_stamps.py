"""Whether a camera's own time stamps are contradicted where they are right, and corrected where they are wrong, without pictures.

    python -m benchmarks.camera_stamps [--seeds 31 32 33 34 35 36] [--vehicles plane copter] [--seconds 120]

The simulated vehicles fly the bent loop of the scenarios, or straight on, with the attitudes of the built-in autopilot each 30
ms: its usual ones, or those of gyroscopes like PX4's simulator's. Turns between frames, four a second, are true ones with the
errors of rendered frames over NAIP (0.022, 0.030 and 0.011 degrees, Student's with 4 degrees of freedom). Stamps are right, 60 ms
late, or 60 ms early, and said to be the camera's own.

known: share of the time at which the offset's 1-sigma is 10 ms or less; false: at which it is, and the offset off by more than 3
sigma; moved: at which frames are moved to more than 40 ms from when they were taken; told: flights in which an offset is told
that is more than 30 ms off. known after: s, median and slowest, of flights in which it came to be known; corrected after: until
frames are moved to within 20 ms.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera.camera_time import SURE_S, CameraTime
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.geo.se3 import quat_from_euler, quat_from_vector, quat_inverse, quat_multiply
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.setup import SPEED_MPS, WIND_NED_MPS, VehicleKind
from visloc_companion.sim.vehicles.vehicle_model import PX4_SIH, USUAL
from visloc_companion.types import AutopilotKind, FloatArray, FrameRef, GeoPoint, Notice, Quat, Turn

HOME = GeoPoint(46.0, 8.0, 400.0)
HALF_M, HEIGHT_M, STEP_S = 400.0, 150.0, 0.01
WAYS = {
    "loop": ((1.0, -0.6), (0.8, 1.0), (-0.2, 0.5), (-1.0, 0.9), (-0.7, -1.0)),
    "straight": ((0.0, 0.0), (12.0, 0.3), (24.0, -0.3), (36.0, 0.0)),
}
"""North and east of home, in HALF_M."""
MODELS = {"usual": USUAL, "poor gyroscopes": PX4_SIH}
OFFSETS_S = {"right": 0.0, "60 ms late": -0.06, "60 ms early": 0.06}
TURN_RAD = np.radians([0.022, 0.030, 0.011])
SETTLE_S, FRAME_STEPS, ATTITUDE_STEPS, ANSWER_STEPS = 1.7, 25, 3, 15
CLOCK_NS = 7_000_000_000
STILL = (0.0, 0.0, 0.0)
HEAD = "| vehicle | attitudes | way | stamps | known | false | moved | told | known after | corrected after |"


@dataclass(frozen=True, slots=True)
class Moment:
    """After an answer, s since the first frame: offset, its 1-sigma, by how much frames are moved (s), whether it was told."""

    t_s: float
    offset_s: float
    sigma_s: float
    moved_s: float
    told: bool


def flown(vehicle: VehicleKind, way: str, attitudes: str, seed: int, seconds: float, offset_s: float) -> list[Moment]:
    """One flight; `offset_s`: from a frame's stamp to when it was taken."""
    points = tuple((north * HALF_M, east * HALF_M, -HEIGHT_M) for north, east in WAYS[way])
    speed, kind = SPEED_MPS[vehicle], AutopilotKind.ARDUPILOT
    pilot = BuiltInAutopilot(kind, vehicle, HOME, points, speed, seed, None, WIND_NED_MPS, model=MODELS[attitudes])
    rng = np.random.default_rng(seed)
    clock, attitude = ClockOffset(), AttitudeBuffer()
    camera = CameraTime(clock, attitude)
    last: tuple[int, Quat] | None = None
    answer: Turn | None = None
    moments: list[Moment] = []
    for k in range(round((SETTLE_S + seconds) / STEP_S)):
        pilot.step(STEP_S)
        pilot.outgoing()
        t_ns, frames = pilot.t_boot_ns, k - round(SETTLE_S / STEP_S)
        if k % ATTITUDE_STEPS == 0:
            clock.on_arrival(t_ns + CLOCK_NS, t_ns)
            attitude.add(t_ns, quat_from_euler(*pilot.flight.attitude.euler(pilot.flight.body)), STILL)
        if frames < 0:
            continue
        if frames % FRAME_STEPS == 0:
            stamp_ns = t_ns - round(offset_s * 1e9)
            frame = FrameRef(t_ns + CLOCK_NS, stamp_ns + CLOCK_NS, frames // FRAME_STEPS + 1, 0, 640, 480, 3, stamp_ns)
            given_ns, q = camera.on_frame(frame).t_ns, pilot.truth().q_ned_frd
            moved_s = (given_ns - stamp_ns - CLOCK_NS) * 1e-9
            answer = None if last is None else _turn(last, (given_ns, q), rng)
            last = given_ns, q
        if frames % FRAME_STEPS == ANSWER_STEPS:
            told = any(isinstance(command, Notice) for command in camera.on_turn(answer, (1.0, 0.0, 0.0, 0.0)))
            best = camera.estimate
            moments.append(Moment(frames * STEP_S, best.offset_s, best.sigma_s, moved_s, told))
    return moments


def _turn(before: tuple[int, Quat], now: tuple[int, Quat], rng: np.random.Generator) -> Turn:
    x, y, z = (rng.standard_t(4, 3) * TURN_RAD / math.sqrt(2)).tolist()
    a, b, c = (TURN_RAD**2).tolist()
    q = quat_multiply(quat_multiply(quat_inverse(before[1]), now[1]), quat_from_vector((x, y, z)))
    return Turn(before[0], now[0], q, ((a, 0.0, 0.0), (0.0, b, 0.0), (0.0, 0.0, c)))


def row(flights: list[list[Moment]], true_s: float) -> str:
    """The figures of flights with the same offset."""
    every = [moment for flight in flights for moment in flight]

    def share(which: Callable[[Moment], bool]) -> str:
        return f"{100 * np.mean([which(moment) for moment in every]):.1f} %"

    def after(which: Callable[[Moment], bool]) -> str:
        first: FloatArray = np.array([next((m.t_s for m in flight if which(m)), math.nan) for flight in flights])
        known = first[np.isfinite(first)]
        never = f", {len(first) - len(known)} never" if len(known) < len(first) else ""
        return f"{np.median(known):.0f}, {known.max():.0f} s{never}" if len(known) else "never"

    told = sum(any(m.told and abs(m.offset_s - true_s) > 0.03 for m in flight) for flight in flights)
    cells = [
        share(lambda m: m.sigma_s <= SURE_S),
        share(lambda m: m.sigma_s <= SURE_S and abs(m.offset_s - true_s) > 3 * m.sigma_s),
        share(lambda m: m.moved_s != 0 and abs(m.moved_s - true_s) > 0.04),
        str(told),
        after(lambda m: m.sigma_s <= SURE_S and abs(m.offset_s - true_s) <= max(SURE_S, 3 * m.sigma_s)),
        "–" if true_s == 0 else after(lambda m: m.moved_s != 0 and abs(m.moved_s - true_s) < 0.02),
    ]
    return " | ".join(cells)


def rows(options: argparse.Namespace) -> Iterator[str]:
    """Markdown, one row for each vehicle, autopilot, way and offset."""
    for vehicle in options.vehicles:
        for attitudes in MODELS:
            for way in WAYS:
                for stamps, offset_s in OFFSETS_S.items():
                    flights = [flown(vehicle, way, attitudes, seed, options.seconds, offset_s) for seed in options.seeds]
                    yield f"| {vehicle} | {attitudes} | {way} | {stamps} | {row(flights, offset_s)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[31, 32, 33, 34, 35, 36])
    parser.add_argument("--vehicles", nargs="+", default=["plane", "copter"], choices=["plane", "copter"])
    parser.add_argument("--seconds", type=float, default=120.0)
    print(f"{HEAD}\n|{'---|' * (HEAD.count('|') - 1)}", flush=True)
    for line in rows(parser.parse_args()):
        print(line, flush=True)


if __name__ == "__main__":
    main()
