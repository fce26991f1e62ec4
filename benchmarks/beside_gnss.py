"""Does a level hold that believes a GNSS beside it? `python -m benchmarks.beside_gnss [--flights N] [--speed M/S] ...`.

Drawn flights of the filter alone, high above a coarse map, in which everything errs as it is stated: the mounting stays (of
`--mounted-deg` in truth, of MOUNTING_RAD as it is stated), the attitude's tilt and the ground's slope come and go, and what is
known of the tilt is the best that can be known of it (a Kalman filter of these six), so a fix claims what it errs by, or
(`--memory`) what the navigator knows of it (core/camera/tilt_memory.py); GNSS is off by the same all the time (or `--drag-mps`
away), the map as well. After `--turn-s` the vehicle turns by `--turn-deg`, `--turns` times, each as long after the last. GNSS is
there until `--jam-s`, and taken to be false with `--false`.

Prints for each stretch of time: the error, the level that fixes alone make and that with GNSS, both with the share of epochs
within 25 m, epochs beyond it and the largest share of it; and the normalised squared errors (2 is right) of the filter, of what
GNSS holds beside it (core/filter/by_gnss.py) and of a fix, the map's 1-sigma included.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.pages.scenario_page import table
from visloc_companion.core.camera.tilt_memory import TiltMemory
from visloc_companion.core.estimator import PositionFilter
from visloc_companion.core.filter.belief import seeded
from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.lasting import apart_m
from visloc_companion.core.filter.propagation import INERTIAL_WALK_MPS_PER_SQRT_S, Drive
from visloc_companion.core.filter.separation import HELD
from visloc_companion.core.odometry_aiding import OdometryAiding
from visloc_companion.core.satellites.map_offset import GNSS_SIGMA_M
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.geo import wgs84
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.sim.odometry_model import OdometryModel
from visloc_companion.types import Fix, FloatArray, FrameRef, GeoPoint, LocaliseRequest, PosePrior, TiltPrior, TiltSeen

ORIGIN = GeoPoint(59.3, 18.1, 0.0)
DT_S, FIX_STEPS, FRAME_STEPS, SECOND = 0.1, 5, 2, 10
HEIGHT_M, FOOTPRINT_M, MAP_SIGMA_M, NOISE_M, LIMIT_M = 750.0, 860.0, 2.5, 1.5, 25.0
MOUNTING_RAD, ATTITUDE_RAD, SLOPE_RAD, SEEN_RAD = np.radians([0.92, 0.4, 1.5, 0.3]).tolist()
"""1-sigma on each axis; the last of what a picture shows of tilt and slope together."""
ATTITUDE_S, TURNS_IN_S = 20.0, 5.0
SIGMA_V_MPS, SIGMA_A_MPS2 = 0.8, 0.1
STATED_RAD = math.hypot(MOUNTING_RAD, ATTITUDE_RAD)
COLUMNS = (
    *("s", "error, rms on an axis, m", "fixes alone: level m", "within", "beyond", "most of it"),
    *("with GNSS: level m", "within", "beyond", "most of it", "squared: filter", "GNSS holds", "fix"),
)


@dataclass(frozen=True, slots=True)
class Drawn:
    """What is flown; `false` is the probability that the level has for a GNSS that is false."""

    speed_mps: float
    turn_deg: float
    turn_s: float
    jam_s: float
    seconds: float
    drag_mps: float
    false: float
    mounted_rad: float = MOUNTING_RAD
    turns: int = 1
    memory: bool = False

    def heading_rad(self, t_s: float) -> float:
        """Of the vehicle at a time."""
        turns = sum(min(1.0, max(0.0, (t_s - k * self.turn_s) / TURNS_IN_S)) for k in range(1, self.turns + 1))
        return math.radians(self.turn_deg) * turns


@dataclass(frozen=True, slots=True)
class Looked:
    """By how much (2,) what is told of the tilt is off after a picture, the covariance (2, 2) of that, and the mounting's 1-sigma
    in it; rad."""

    off_rad: FloatArray
    cov_rad2: FloatArray
    mounting_rad: float


class Tilt:
    """The camera's tilt and the ground's slope about north and east, and the best that pictures tell of them: mounting ahead and
    aside, attitude, slope (6,)."""

    def __init__(self, rng: np.random.Generator, speed_mps: float, mounted_rad: float) -> None:
        sigma = np.repeat([MOUNTING_RAD, ATTITUDE_RAD, SLOPE_RAD], 2)
        kept = [1.0, math.exp(-DT_S / ATTITUDE_S), math.exp(-speed_mps * DT_S / apart_m(HEIGHT_M))]
        self._kept = np.repeat(kept, 2)
        self._more = sigma**2 * (1 - self._kept**2)
        self._rng, self._true = rng, np.repeat([mounted_rad, ATTITUDE_RAD, SLOPE_RAD], 2) * rng.standard_normal(6)
        self._x, self._P = np.zeros(6), np.diag(sigma**2)

    def go(self) -> None:
        """Through a step."""
        self._true = self._kept * self._true + np.sqrt(self._more) * self._rng.standard_normal(6)
        self._x, self._P = self._kept * self._x, np.outer(self._kept, self._kept) * self._P + np.diag(self._more)

    def look(self, turned: FloatArray) -> Looked:
        """At another picture, while the vehicle is turned by a rotation (2, 2)."""
        seen, z = self._picture(turned)
        gain = self._P @ seen.T @ np.linalg.inv(seen @ self._P @ seen.T + SEEN_RAD**2 * np.eye(2))
        self._x, self._P = self._x + gain @ (z - seen @ self._x), self._P - gain @ seen @ self._P
        tilts = np.hstack([turned, np.eye(2), np.zeros((2, 2))])
        return Looked(tilts @ (self._true - self._x), tilts @ self._P @ tilts.T, math.sqrt(np.trace(self._P[:2, :2]) / 2))

    def _picture(self, turned: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What of the six a picture shows (2, 6), and that (2,)."""
        seen = np.hstack([turned, np.eye(2), np.eye(2)])
        return seen, seen @ self._true + SEEN_RAD * self._rng.standard_normal(2)


class Remembered(Tilt):
    """The same, known as the navigator knows it; how the camera turned from picture to picture is not told."""

    def __init__(self, rng: np.random.Generator, speed_mps: float, mounted_rad: float) -> None:
        super().__init__(rng, speed_mps, mounted_rad)
        self._memory, self._speed_mps, self._number = TiltMemory(STATED_RAD), speed_mps, 0

    def look(self, turned: FloatArray) -> Looked:
        """At another picture, while the vehicle is turned by a rotation (2, 2)."""
        self._number += 1
        t_ns, heading_rad = round(self._number * FIX_STEPS * DT_S * 1e9), math.atan2(turned[1, 0], turned[0, 0])
        q = quat_from_euler(0.0, 0.0, heading_rad)
        known = self._memory.known(t_ns, q) or TiltPrior((0.0, 0.0), STATED_RAD)
        prior = PosePrior(ORIGIN, q, ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.1, STATED_RAD, tilt=known)
        frame = FrameRef(t_ns, t_ns, self._number, 0, 640, 480, 3)
        self._memory.asked(LocaliseRequest(self._number, frame, prior, 0), q)
        _, z = self._picture(turned)
        var, var_rad2 = known.sigma_rad**2, SLOPE_RAD**2 + SEEN_RAD**2
        told = known.turn_ne_rad + var / (var + var_rad2) * (z - known.turn_ne_rad)
        seen = TiltSeen((float(z[0]), float(z[1])), ((var_rad2, 0.0), (0.0, var_rad2)))
        fix = replace(_fix(t_ns, self._number, np.zeros(2), np.eye(2), heading_rad), tilt=seen)
        mounting_rad, more_rad2, turn_rad = self._memory.told(fix, (self._speed_mps, 0.0), HEIGHT_M)
        self._memory.taken(fix, (self._speed_mps, 0.0), HEIGHT_M)
        true = np.hstack([turned, np.eye(2), np.zeros((2, 2))]) @ self._true
        return Looked(true - told - turn_rad, (var * var_rad2 / (var + var_rad2) + more_rad2) * np.eye(2), mounting_rad)


def flown(drawn: Drawn, seed: int) -> FloatArray:
    """(N, 7) of one flight, a row a second: s, error, level of fixes alone, with GNSS, squared errors of the filter, of what GNSS
    holds (NaN without) and of the last fix."""
    rng = np.random.default_rng(seed)
    settings = replace(NavigatorSettings(), map_sigma_m=MAP_SIGMA_M)
    tilt, place = (Remembered if drawn.memory else Tilt)(rng, drawn.speed_mps, drawn.mounted_rad), np.zeros(2)
    by_fix = math.nan
    by_map_m, by_gnss_m = MAP_SIGMA_M * rng.standard_normal(2), GNSS_SIGMA_M * rng.standard_normal(2)
    slow, error_mps = SIGMA_A_MPS2 * rng.standard_normal(2), 0.3 * rng.standard_normal(2)
    eyes, aiding = OdometryModel.drawn(rng), OdometryAiding()
    at = settings.seed_sigma_m * rng.standard_normal(2)
    start = seeded(0, (at[0], at[1]), settings.seed_sigma_m, SIGMA_V_MPS, Drive.INERTIAL, settings)
    position_filter = PositionFilter(settings, ORIGIN, start, _velocity(0, np.zeros(2)))
    kept, found = math.exp(-DT_S / settings.acceleration_correlation_s), list[list[float]]()
    for k in range(1, round(drawn.seconds / DT_S) + 1):
        t_s, t_ns = k * DT_S, round(k * DT_S * 1e9)
        heading = drawn.heading_rad(t_s)
        turned = np.array([[math.cos(heading), -math.sin(heading)], [math.sin(heading), math.cos(heading)]])
        step = drawn.speed_mps * DT_S * turned[:, 0]
        place = place + step
        tilt.go()
        error_mps = error_mps + slow * DT_S + INERTIAL_WALK_MPS_PER_SQRT_S * math.sqrt(DT_S) * rng.standard_normal(2)
        slow = kept * slow + SIGMA_A_MPS2 * math.sqrt(1 - kept**2) * rng.standard_normal(2)
        position_filter.drive(_velocity(t_ns, step / DT_S + error_mps))
        seen = eyes.look(t_ns, place, rng) if k % FRAME_STEPS == 0 else None
        motion = None if seen is None else aiding.on_odometry(seen, inertial_mps2=SIGMA_A_MPS2).of_filter
        if motion is not None:
            position_filter.observe_motion(motion)
        if k % FIX_STEPS == 0:
            looked = tilt.look(turned)
            fix_m = place + by_map_m + HEIGHT_M * looked.off_rad + NOISE_M * rng.standard_normal(2)
            cov_m2 = HEIGHT_M**2 * looked.cov_rad2 + NOISE_M**2 * np.eye(2)
            by_fix = _squared(fix_m - place, cov_m2 + MAP_SIGMA_M**2 * np.eye(2))
            position_filter.observe(_fix(t_ns, k, fix_m, cov_m2, heading), looked.mounting_rad)
        if k % SECOND == 0:
            if t_s <= drawn.jam_s:
                gnss_m = place + by_gnss_m + (0.0, drawn.drag_mps * t_s)
                position_filter.beside_gnss(t_ns, _place(gnss_m), GNSS_SIGMA_M)
            found.append([t_s, *_judged(position_filter, t_ns, place, drawn.false), by_fix])
    return np.array(found)


def _judged(position_filter: PositionFilter, t_ns: int, place: FloatArray, false: float) -> list[float]:
    state, belief = position_filter.at(t_ns), position_filter.newest
    off_m, held = np.array(state.p_ned_m[:2]) - place, math.nan
    if HELD in belief.without.leaves:
        k = belief.without.leaves.index(HELD)
        cov_m2 = belief.without.position_m2[:, k].reshape(2, 2) + MAP_SIGMA_M**2 * np.eye(2)
        held = _squared(belief.without.x[k, :2] - place, cov_m2)
    levels = position_filter.protection_level_m(t_ns), position_filter.protection_level_m(t_ns, false)
    return [float(np.hypot(*off_m)), *levels, _squared(off_m, np.array(state.cov_ne_m2)), held]


def _squared(off_m: FloatArray, cov_m2: FloatArray) -> float:
    return float(off_m @ np.linalg.solve(cov_m2, off_m))


def _velocity(t_ns: int, v_ne_mps: FloatArray) -> Velocity:
    v_ned_mps = (float(v_ne_mps[0]), float(v_ne_mps[1]), 0.0)
    return Velocity(t_ns, v_ned_mps, HEIGHT_M, SIGMA_V_MPS, Drive.INERTIAL, SIGMA_A_MPS2)


def _place(ne_m: FloatArray) -> GeoPoint:
    return wgs84.geo_from_ned((float(ne_m[0]), float(ne_m[1]), -HEIGHT_M), ORIGIN)


def _fix(t_ns: int, number: int, ne_m: FloatArray, cov_m2: FloatArray, heading_rad: float) -> Fix:
    (nn, ne), (en, ee) = cov_m2.tolist()
    q, cov = quat_from_euler(0.0, 0.0, heading_rad), ((nn, ne), (en, ee))
    return Fix(t_ns, t_ns, number, number, "deep", _place(ne_m), q, cov, 2.0, 0.1, 1e-3, 5.0, footprint_m=FOOTPRINT_M)


def rows(flights: FloatArray, every_s: float) -> list[list[str]]:
    """Of flights (K, N, 7), one row for each so many seconds."""
    found = []
    for since_s in np.arange(0.0, flights[0, -1, 0], every_s).tolist():
        _, error, alone, beside, own, held, by_fix = (
            flights[:, (flights[0, :, 0] > since_s) & (flights[0, :, 0] <= since_s + every_s)].reshape(-1, 7).T
        )
        levels = [
            cell
            for level in (alone, beside)
            for cell in (
                f"{np.median(level):.1f}",
                f"{100 * np.mean(level <= LIMIT_M):.0f} %",
                f"{np.sum(error > level)} of {len(level)}",
                f"{np.max(error / level):.2f}",
            )
        ]
        told = f"{np.nanmean(held):.2f}" if np.isfinite(held).any() else "–"
        found.append(
            [
                f"{since_s:.0f} to {since_s + every_s:.0f}",
                f"{math.sqrt(np.mean(error**2) / 2):.1f}",
                *levels,
                f"{own.mean():.2f}",
                told,
                f"{by_fix.mean():.2f}",
            ]
        )
    return found


def parse_args(argv: Sequence[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=60)
    parser.add_argument("--seed", type=int, default=5000)
    parser.add_argument("--speed", type=float, default=10.0, help="m/s")
    parser.add_argument("--turn-deg", type=float, default=120.0)
    parser.add_argument("--turn-s", type=float, default=70.0)
    parser.add_argument("--jam-s", type=float, default=30.0)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--drag-mps", type=float, default=0.0)
    parser.add_argument("--false", type=float, default=0.016)
    parser.add_argument("--mounted-deg", type=float, default=math.degrees(MOUNTING_RAD))
    parser.add_argument("--turns", type=int, default=1)
    parser.add_argument("--memory", action="store_true", help="what the navigator knows of the tilt")
    parser.add_argument("--every", type=float, default=10.0, help="seconds")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> None:
    """Fly, count, print."""
    args = parse_args(argv)
    what = args.speed, args.turn_deg, args.turn_s, args.jam_s, args.seconds, args.drag_mps, args.false
    drawn = Drawn(*what, math.radians(args.mounted_deg), args.turns, args.memory)
    print(table(COLUMNS, rows(np.array([flown(drawn, args.seed + k) for k in range(args.flights)]), args.every)))


if __name__ == "__main__":
    main()
