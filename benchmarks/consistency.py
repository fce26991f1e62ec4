"""Is what the daemon states consistent with its error? `python -m benchmarks.consistency [--flights N] [--seconds S] ...`.

Whole flights in closed loop with the built-in autopilot, MAVLink, navigator and filter, but without pictures: the localiser knows
the truth and errs as it claims (consistency_eyes.py). GNSS is jammed after a minute. Wind, the map's wandering error, wrong
matches and odometry's lasting errors are the seed's.

Prints for each kind of flight, over every status (10 a second) from SETTLED_S after the jam on: the horizontal error; the mean
normalised squared error (NEES, 2 where the stated covariance is right) with the 95 % band of its mean over flights (bootstrap:
epochs of one flight are not independent); epochs beyond the protection level; hazardously misleading ones (beyond the alert
limit, the level not); the level, and its median over that of the error.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.flown.consistency_eyes import EyesModel, KnowingEyes
from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.app.journal import Entry
from visloc_companion.core.navigator import Navigator
from visloc_companion.core.settings import CoreSettings, InjectionSettings
from visloc_companion.geo import wgs84
from visloc_companion.sim import faults
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.flight import ClosedLoopFlight, Eyes, FlightLog
from visloc_companion.sim.scenarios import Scenario
from visloc_companion.sim.setup import FlightArea, FlightSetup, VehicleKind
from visloc_companion.testing.hills import HillyMap
from visloc_companion.types import AutopilotKind, FloatArray, GeoPoint, Status

HOME = GeoPoint(59.3, 18.1, 40.0)
JAM_S, SETTLED_S = 60.0, 10.0
FRAME_RATE_HZ, LATENCY_S = 4.0, 0.25
ALERT_LIMIT_M = 25.0


@dataclass(frozen=True, slots=True, eq=False)
class Epochs:
    """Of the statuses of one flight without GNSS: time (N,), error (N, 2), stated covariance (N, 2, 2), level (N,)."""

    t_s: FloatArray
    error_ne_m: FloatArray
    cov_ne_m2: FloatArray
    level_m: FloatArray
    failsafe: str | None = None

    @property
    def nees(self) -> FloatArray:
        """(N,) normalised squared errors."""
        return np.asarray(
            np.einsum("ni,ni->n", self.error_ne_m, np.linalg.solve(self.cov_ne_m2, self.error_ne_m[..., None])[..., 0])
        )

    @property
    def error_m(self) -> FloatArray:
        """(N,) horizontal errors."""
        return np.asarray(np.hypot(self.error_ne_m[:, 0], self.error_ne_m[:, 1]))


def flown(vehicle: VehicleKind, seed: int, seconds: float, model: EyesModel, settings: CoreSettings | None = None) -> Epochs:
    """One flight, jammed from JAM_S on."""
    settings = settings or CoreSettings(injection=InjectionSettings(switch_source=True), max_rate_hz=FRAME_RATE_HZ)
    scenario = Scenario("jam", "", seconds, faults.jam(JAM_S))
    pilot = pilot_of(scenario, AutopilotKind.ARDUPILOT, vehicle, seed)
    log = over_hills(pilot, KnowingEyes(model, seed, settings.navigator.map_sigma_m), settings).run(seconds)
    return epochs(log, JAM_S + SETTLED_S)


def pilot_of(scenario: Scenario, kind: AutopilotKind, vehicle: VehicleKind, seed: int) -> BuiltInAutopilot:
    """The autopilot of a flight about HOME."""
    return FlightSetup(scenario, FlightArea(HOME, 1000.0, 0.5), kind, vehicle, seed).autopilot()


def over_hills(
    pilot: BuiltInAutopilot, eyes: KnowingEyes, settings: CoreSettings, on_entry: Callable[[Entry], None] | None = None
) -> ClosedLoopFlight:
    """A flight of the daemon's core with these eyes, ready to run."""
    seen = Eyes(eyes, eyes, HillyMap(HOME, 3000.0, 1.0, seed=1), FRAME_RATE_HZ, LATENCY_S)  # type: ignore[arg-type]
    return ClosedLoopFlight(pilot, Navigator(settings), MavlinkSession(SessionSettings()), seen, on_entry=on_entry)


def epochs(log: FlightLog, from_s: float) -> Epochs:
    """The statuses with a position from a time of the flight on, against the truth between its samples."""
    t0_ns = log.truth[0].t_ns
    truth_t = np.array([sample.t_ns - t0_ns for sample in log.truth]) * 1e-9
    truth_ned = np.array([wgs84.ned_from_geo(sample.place, HOME) for sample in log.truth])
    stated = [e.command for e in log.entries if isinstance(e.command, Status) and e.command.place is not None]
    stated = [s for s in stated if (s.t_ns - t0_ns) * 1e-9 >= from_s]
    t_s = np.array([(s.t_ns - t0_ns) * 1e-9 for s in stated])
    ours = np.array([wgs84.ned_from_geo(s.place, HOME)[:2] for s in stated if s.place is not None]).reshape(-1, 2)
    true = np.stack([np.interp(t_s, truth_t, truth_ned[:, k]) for k in range(2)], axis=1)
    cov = np.array([s.cov_ne_m2 for s in stated]).reshape(-1, 2, 2)
    level = np.array([np.inf if s.protection_level_m is None else s.protection_level_m for s in stated])
    return Epochs(t_s, ours - true, cov, level, log.failsafe)


def figures(flights: Sequence[Epochs]) -> dict[str, Any]:
    """What is printed of flights of one kind."""
    error, level = np.concatenate([f.error_m for f in flights]), np.concatenate([f.level_m for f in flights])
    means = np.array([float(f.nees.mean()) for f in flights])
    low, high = band(means)
    return {
        "flights": len(flights),
        "epochs": len(error),
        "error_median_m": float(np.median(error)),
        "error_p95_m": float(np.percentile(error, 95)),
        "error_max_m": float(error.max()),
        "nees": float(means.mean()),
        "nees_low": low,
        "nees_high": high,
        "misleading": int((error > level).sum()),
        "hmi": int(((error > ALERT_LIMIT_M) & (level <= ALERT_LIMIT_M)).sum()),
        "level_median_m": float(np.median(level)),
        "level_over_error": float(np.median(level) / np.median(error)),
        "failsafes": sum(f.failsafe is not None for f in flights),
    }


def band(means: FloatArray, n: int = 2000) -> tuple[float, float]:
    """95 % band of the mean over flights, by bootstrap."""
    rng = np.random.default_rng(1)
    resampled = means[rng.integers(0, len(means), (n, len(means)))].mean(axis=1)
    return float(np.percentile(resampled, 2.5)), float(np.percentile(resampled, 97.5))


KINDS: dict[str, EyesModel] = {
    "fixes": EyesModel(odometry=False, wrong=False),
    "fixes, odometry": EyesModel(wrong=False),
    "wrong matches": EyesModel(odometry=False),
    "wrong matches, odometry": EyesModel(),
    "sight that comes and goes": EyesModel(fix_share=0.2, seeing_s=10.0, blind_s=8.0),
    "overconfident": EyesModel(odometry=False, wrong=False, overconfident=3.0),
}


def main(argv: Sequence[str] | None = None) -> None:
    """Fly, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=50, help="of each kind and vehicle")
    parser.add_argument("--seconds", type=float, default=150.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--vehicles", nargs="*", choices=["copter", "plane"], default=["copter", "plane"])
    parser.add_argument("--kinds", nargs="*", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--json", type=Path)
    args = parser.parse_args(argv)
    rows = []
    print("| flights | n | epochs | error 50/95/max m | NEES (95 %) | misleading | HMI | level 50 m | ratio | failsafes |")
    print("|" + "---|" * 10)
    for vehicle in args.vehicles:
        for kind in args.kinds:
            f = figures([flown(vehicle, 1000 * args.seed + k, args.seconds, KINDS[kind]) for k in range(args.flights)])
            rows.append({"vehicle": vehicle, "kind": kind, **f})
            print(
                f"| {vehicle}, {kind} | {f['flights']} | {f['epochs']} | {f['error_median_m']:.2f} / {f['error_p95_m']:.2f} / "
                f"{f['error_max_m']:.1f} | {f['nees']:.2f} ({f['nees_low']:.2f}-{f['nees_high']:.2f}) | "
                f"{f['misleading']} | {f['hmi']} | {f['level_median_m']:.1f} | {f['level_over_error']:.1f} | {f['failsafes']} |",
                flush=True,
            )
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
