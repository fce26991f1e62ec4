"""How much of a fix's error lasts: what neighbouring frames get wrong in common, by the distance between them.

    python -m benchmarks.lasting [--worlds 11 12 ...] [--width 320] [--method deep] [--fixes FILE] [--no-flights]
        [--anew] [--without-turns] [--wander-deg 0.3] [--wander-s 20]

A vehicle flies up to LEG_M of each of the first LEGS legs of the scenarios' loop over procedural worlds, 120 m above home; the
camera shows one date, the map is of another, years before. A frame every STEP_M, of an attitude that wavers; the prior errs by 2
m in each frame, its heading and height by what lasts for a leg, its tilt by that of the mounting, which stays, and of the
autopilot, which wanders; what fixes and turns tell of both is kept as in the daemon (core/camera/tilt_memory.py), with --anew it
is not. The filter takes SHARE (core/filter/lasting.py) of the variance that fixes claim for common to those of some seconds; here
is what they have in common, as a share of what they claim. With --fixes the errors are added to a file, and all that are in it
are counted.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.pages.scenario_page import table
from benchmarks.scenarios import Worlds
from visloc_companion.config import DEFAULT_METHOD
from visloc_companion.core.camera.tilt_memory import TiltMemory
from visloc_companion.evaluate.closed_loop import eyes_over
from visloc_companion.geo.se3 import quat_from_euler, quat_from_vector, quat_multiply
from visloc_companion.geo.wgs84 import geo_from_ned, ned_from_geo
from visloc_companion.maps.pack import PackMap
from visloc_companion.sim.flight import Eyes
from visloc_companion.sim.scenarios import SCENARIOS
from visloc_companion.sim.setup import FlightSetup
from visloc_companion.types import AutopilotKind, Fix, FloatArray, FrameRef, LocaliseRequest, PosePrior, Quat, Vec3

SIZE_M, LEGS, LEG_M, STEP_M = 1000.0, 4, 350.0, 5.0
SPEED_MPS = 10.0
PRIOR_M, HEIGHT_M, YAW_RAD = 2.0, 1.5, math.radians(1.5)
MOUNTING_RAD = math.radians(0.5)
"""1-sigma of the mounting's tilt about each axis of the vehicle."""
STATED_RAD = math.radians(1.0)
"""What the configuration says of both together."""
WAVER_RAD = math.radians(2.0)
LEVEL_RAD = np.array([0.0, math.radians(-4.0)])
"""Roll and pitch of a copter on its way."""
APART_M = (0.0, 5.0, 10.0, 20.0, 30.0, 50.0, 75.0, 100.0, 150.0, 200.0)
SMOOTHED = 5
BEYOND = (2.0, 2.5, 3.0, 3.5)
Row = list[float]
"""Leg, metres from its start, error north and east (m), claimed variance north and east (m²)."""


@dataclass(frozen=True, slots=True)
class Tilts:
    """The autopilot's own tilt about north and east, 1-sigma, and the time in which it goes by (as of the built-in one); `anew`:
    every frame begins without what the ones before told; `with_turns`: what pictures show of turns is used."""

    wander_rad: float = math.radians(0.3)
    wander_s: float = 20.0
    anew: bool = False
    with_turns: bool = True


class Believed:
    """The attitude that the autopilot and the configuration make of the camera's true one."""

    def __init__(self, rng: np.random.Generator, tilts: Tilts) -> None:
        self._rng, self._tilts = rng, tilts
        self._mounting_rad = rng.normal(0, MOUNTING_RAD, 2)
        self._attitude_rad = rng.normal(0, tilts.wander_rad, 2)

    def after(self, dt_s: float, q_true: Quat, wrong_yaw_rad: float) -> Quat:
        """What is believed so long after the last."""
        keep = math.exp(-dt_s / self._tilts.wander_s)
        news = math.sqrt(1 - keep**2) * self._rng.normal(0, self._tilts.wander_rad, 2)
        self._attitude_rad = keep * self._attitude_rad + news
        roll, pitch = self._mounting_rad.tolist()
        north, east = self._attitude_rad.tolist()
        turned = quat_multiply(quat_from_vector((north, east, wrong_yaw_rad)), q_true)
        return quat_multiply(turned, quat_from_vector((roll, pitch, 0.0)))


def leg_poses(start: FloatArray, end: FloatArray, rng: np.random.Generator) -> Iterator[tuple[float, Vec3, Quat]]:
    """Metres from the start, place and attitude."""
    along = end - start
    length, yaw = float(np.hypot(along[0], along[1])), math.atan2(along[1], along[0])
    for k in range(int(min(length, LEG_M) / STEP_M)):
        roll, pitch = (rng.normal(0, WAVER_RAD, 2) + LEVEL_RAD).tolist()
        north, east, down = (start + along * (STEP_M * k / length)).tolist()
        yield STEP_M * k, (north, east, down), quat_from_euler(roll, pitch, yaw)


def flown(setup: FlightSetup, eyes: Eyes, reference: PackMap, rng: np.random.Generator, tilts: Tilts) -> list[Row]:
    """The fixes of all legs."""
    corners, home, rows, number = np.array(setup.mission_ned_m()), setup.area.home, list[Row](), 0
    believed, memory = Believed(rng, tilts), TiltMemory(STATED_RAD)
    for leg, (start, end) in enumerate(zip(corners[:LEGS], np.roll(corners, -1, axis=0)[:LEGS], strict=True)):
        height_m, wrong_yaw = rng.normal(0, HEIGHT_M), rng.normal(0, YAW_RAD)
        for at_m, (north, east, down), q_true in leg_poses(start, end, rng):
            number += 1
            t_ns = round(number * STEP_M / SPEED_MPS * 1e9)
            pixels = eyes.camera.render(geo_from_ned((north, east, down), home), q_true, number)
            off_north, off_east = rng.normal(0, PRIOR_M, 2).tolist()
            about = geo_from_ned((north + off_north, east + off_east, down + height_m), home)
            cov, q = ((PRIOR_M**2, 0.0), (0.0, PRIOR_M**2)), believed.after(STEP_M / SPEED_MPS, q_true, wrong_yaw)
            tilt = None if tilts.anew else memory.known(t_ns, q)
            if tilt is not None and not tilts.with_turns:
                tilt = replace(tilt, before=None)
            prior = PosePrior(about, q, cov, 2.0, math.radians(2.0), STATED_RAD, tilt=tilt)
            request = LocaliseRequest(number, FrameRef(number, t_ns, number, 0, pixels.shape[1], pixels.shape[0], 3), prior, 1)
            memory.asked(request, q)
            answer = eyes.localiser.localise(request, pixels, reference)
            if answer.turn is not None and tilts.with_turns:
                memory.turned(answer.turn, answer.turn_since_kept)
            if isinstance(answer, Fix):
                memory.taken(answer, (SPEED_MPS, 0.0), -down)
                n, e, _ = ned_from_geo(answer.place, home)
                (nn, _), (_, ee) = answer.cov_ne_m2
                rows.append([float(leg), at_m, n - north, e - east, nn, ee])
    return rows


def of_world(number: int, width_px: int, method: str, tilts: Tilts) -> list[Row]:
    """The fixes over the procedural world of a number."""
    scenario = SCENARIOS["jam"]
    world = Worlds(SIZE_M, number).on(scenario.date)
    setup = FlightSetup(scenario, world.area(), AutopilotKind.ARDUPILOT, "copter", number, width_px=width_px)
    rng = np.random.default_rng([number, 9])
    return flown(setup, eyes_over(setup, world, method), world.reference, rng, tilts)


def common(legs: list[FloatArray]) -> list[tuple[float, float, int]]:
    """For each distance: the mean product of errors over what they claim, per axis, and of how many pairs."""
    found = []
    for apart_m in APART_M:
        total, n = 0.0, 0
        for leg in legs:
            z, at_m = leg[:, 2:4] / np.sqrt(leg[:, 4:6]), leg[:, 1]
            pairs = np.abs(at_m[:, None] - at_m[None, :] - apart_m) < STEP_M / 2
            total, n = total + float((z @ z.T)[pairs].sum()) / 2, n + int(pairs.sum())
        found.append((apart_m, total / max(n, 1), n))
    return found


def smoothed(legs: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """(N, 2) the mean error of SMOOTHED fixes in a row, metres, and over what one of them claims."""
    mean = np.ones(SMOOTHED) / SMOOTHED
    each = [np.apply_along_axis(np.convolve, 0, leg[:, 2:6], mean, "valid") for leg in legs if len(leg) >= SMOOTHED]
    return np.concatenate([e[:, :2] for e in each]), np.concatenate([e[:, :2] / np.sqrt(e[:, 2:]) for e in each])


def rms(values: FloatArray) -> float:
    """Root of the mean square."""
    return float(np.sqrt((values**2).mean()))


def main(argv: Sequence[str] | None = None) -> None:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, nargs="+", default=[11, 12, 13, 14])
    parser.add_argument("--width", type=int, default=320, help="columns of the camera")
    parser.add_argument("--method", default=DEFAULT_METHOD)
    parser.add_argument("--anew", action="store_true", help="every frame begins without what was learned of the tilt")
    parser.add_argument("--without-turns", action="store_true", help="what pictures show of turns is not used")
    parser.add_argument("--wander-deg", type=float, default=0.3, help="1-sigma of the autopilot's own tilt")
    parser.add_argument("--wander-s", type=float, default=20.0, help="in which it goes by")
    parser.add_argument("--fixes", type=Path)
    parser.add_argument("--no-flights", action="store_true", help="only count what is in --fixes")
    options = parser.parse_args(argv)
    cv2.setNumThreads(1)
    tilts = Tilts(math.radians(options.wander_deg), options.wander_s, options.anew, not options.without_turns)
    worlds: dict[str, list[Row]] = {}
    if options.fixes is not None and options.fixes.exists():
        worlds = json.loads(options.fixes.read_text(encoding="utf-8"))
    for number in [] if options.no_flights else options.worlds:
        worlds[str(number)] = of_world(number, options.width, options.method, tilts)
        if options.fixes is not None:
            options.fixes.write_text(json.dumps(worlds), encoding="utf-8")
    every = [np.array(rows) for rows in worlds.values() if rows]
    legs = [rows[rows[:, 0] == leg] for rows in every for leg in np.unique(rows[:, 0])]
    fixes = np.concatenate(legs)
    print(f"worlds {', '.join(worlds)}: {len(fixes)} fixes, error per axis {rms(fixes[:, 2:4]):.2f} m rms, ", end="")
    print(f"over sigma {rms(fixes[:, 2:4] / np.sqrt(fixes[:, 4:6])):.2f}\n")
    rows = [[f"{apart_m:.0f}", f"{share:.2f}", str(n)] for apart_m, share, n in common(legs)]
    print(table(("m apart", "in common, of the claimed variance", "pairs"), rows))
    off_m, mean = smoothed(legs)
    beyond = ", ".join(f"{(np.abs(mean) > limit).mean():.4f} beyond {limit:g}" for limit in BEYOND)
    print(f"\nMean of {SMOOTHED} in a row, per axis: {rms(off_m):.2f} m rms; over one's sigma {rms(mean):.2f}, {beyond}", end="")
    print(f", most {float(np.abs(mean).max()):.1f}")


if __name__ == "__main__":
    main()
