"""How far frame-to-frame odometry drifts, what it claims, what it costs, and when it says that it sees nothing.

    python -m benchmarks.odometry [--seeds 101 102 103] [--vehicles copter leaning plane hover] [--knows map range map,range home]
        [--draws 3] [--keep DIR] [--json FILE]

Flights of odometry_world.py, 60 frames each. `knows`: `map` is a place on a surface model years apart from the picture, `range`
a rangefinder and no surface model, `home` the height above the start and nothing else. Each flight is flown several times with
errors drawn anew. Seeds below 100 served for tuning and for the factors of the claims.

drift: error at the end as a share of the path, root mean square and worst; `heading, lens known`: the same after the drawn
constant errors of the heading (1 degree; whatever turns it about the vertical) and of the focal length (1.5 %) are taken off.
error/sigma: root mean square over legs (keyframe to keyframe) and over whole flights (core/odometry.py), north, east and of legs
down. CPU: process time of one frame beside that of SIFT on the same pictures.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.worlds.odometry_world import MODEL, Errors, Flight, flight_of, sights
from visloc_companion.core.odometry import OdometryTrack
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler
from visloc_companion.localise.flow import FrameToFrame
from visloc_companion.localise.odometry.base import Sight, Step
from visloc_companion.localise.pose import heading_and_tilt
from visloc_companion.types import CameraModel, FloatArray

SIFT_FRAMES = 3


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """One flight with one draw of errors: legs' errors and sigmas (L, 6: north, east, the two sigmas, down, its
    sigma), the end's (4,), the end's error with and without the errors of heading and lens, reasons, milliseconds of a frame."""

    flight: Flight
    legs: FloatArray
    end: FloatArray
    off_m: float
    off_known_m: float
    unseen_s: float
    reasons: Counter[str]
    ms: float


def flown(flight: Flight, errors: Errors, seed: int, knows: str) -> Flown:
    """Fly it."""
    given = sights(flight, errors, np.random.default_rng(seed), knows)
    surface = flight.surface if "map" in knows else None
    lens = errors.lens * float(np.random.default_rng([seed, 1]).standard_normal())
    flow, track = FrameToFrame(calibrated(lens)), OdometryTrack()
    number = {sight.t_ns: k for k, sight in enumerate(given)}
    legs, reasons = [], Counter[str]()
    started = time.process_time()
    steps = [flow.step(sight, surface) for sight in given]
    ms = 1000 * (time.process_time() - started) / len(given)
    for k, step in enumerate(steps):
        if not isinstance(step, Step):
            reasons[step.reason.value] += k > 0
            continue
        odometry = step.odometry
        track.add(odometry)
        if step.closes or k == len(steps) - 1:
            true = flight.p_ned_m[number[odometry.t_to_ns]] - flight.p_ned_m[number[odometry.t_from_ns]]
            error = np.array(odometry.displacement_ned_m) - true
            legs.append([*_judged(error[:2], np.array(odometry.cov_ne_m2)), error[2], step.sigma_down_m])
    whole = track.between(given[0].t_ns, given[-1].t_ns)
    if whole is None:
        return Flown(flight, np.array(legs).reshape(-1, 6), np.full(4, np.nan), math.nan, math.nan, math.nan, reasons, ms)
    d, true = np.array(whole.displacement_ned_m)[:2], (flight.p_ned_m[-1] - flight.p_ned_m[0])[:2]
    turn = mean_turn(given, flight)
    back = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    known_d = back @ (d - lens * (d + np.array(whole.per_focal_ne_m)))
    off, known = float(np.hypot(*(d - true))), float(np.hypot(*(known_d - true)))
    return Flown(flight, np.array(legs), _judged(d - true, np.array(whole.cov_ne_m2)), off, known, whole.unseen_s, reasons, ms)


def calibrated(lens: float) -> CameraModel:
    """The camera as it is calibrated where the true focal length is longer by a share."""
    return replace(MODEL, fx_px=MODEL.fx_px / (1 + lens), fy_px=MODEL.fy_px / (1 + lens))


def mean_turn(given: list[Sight], flight: Flight) -> float:
    """Mean error of the heading, whatever turns both have made: about the vertical, as fixes tell it and odometry is turned
    back in flight. Of a body that leans, an error of roll is one of heading, too (half of it at 30 degrees); yaws hide that."""
    off = []
    for sight, euler in zip(given, flight.euler_rad, strict=True):
        true = R_from_quat(quat_from_euler(*(float(a) for a in euler)))
        off.append(heading_and_tilt(R_from_quat(sight.q_ned_frd), true)[0])
    return float(np.angle(np.mean(np.exp(1j * np.array(off)))))


def _judged(error: FloatArray, cov: FloatArray) -> FloatArray:
    """(4,) error north and east, 1-sigma north and east."""
    return np.array([*error, math.sqrt(cov[0, 0]), math.sqrt(cov[1, 1])])


def figures(some: list[Flown]) -> dict[str, Any]:
    """Figures of a row."""
    legs, ends = np.vstack([f.legs for f in some]), np.array([f.end for f in some])
    paths = np.array([max(f.flight.distance_m, 1e-9) for f in some])
    off, known = (np.array([getattr(f, name) for f in some]) for name in ("off_m", "off_known_m"))
    reasons: Counter[str] = sum((f.reasons for f in some), Counter())
    return {
        "flights": len(some),
        "path_m": float(paths.mean()),
        "off_m": _rms(off),
        "drift": _rms(off / paths),
        "drift_worst": float(np.nanmax(off / paths)),
        "drift_known": _rms(known / paths),
        "drift_known_worst": float(np.nanmax(known / paths)),
        "legs": len(legs),
        "leg_error_over_sigma": [_rms(legs[:, k] / legs[:, m]) for k, m in ((0, 2), (1, 3), (4, 5))],
        "end_error_over_sigma": [_rms(ends[:, k] / ends[:, 2 + k]) for k in (0, 1)],
        "unseen_s": float(np.nansum([f.unseen_s for f in some])),
        "reasons": {name: n for name, n in reasons.items() if n},
        "cpu_ms": float(np.median([f.ms for f in some])),
    }


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))


def sift_ms(flight: Flight) -> float:
    """Process time of SIFT (detection and description) on some of the pictures."""
    sift = cv2.SIFT_create()
    times = []
    for frame in flight.frames[:: len(flight.frames) // SIFT_FRAMES]:
        started = time.process_time()
        sift.detectAndCompute(frame, None)
        times.append(1000 * (time.process_time() - started))
    return float(np.median(times))


def table(rows: list[dict[str, Any]]) -> list[str]:
    """Markdown."""
    lines = [
        "| flight | knows | flights | path m | drift, worst | heading, lens known | legs: error/sigma | flights: error/sigma "
        "| blind | CPU ms, of SIFT |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        hover = r["path_m"] < 100
        drift = f"{r['off_m']:.2f} m" if hover else f"{r['drift']:.2%}, {r['drift_worst']:.2%}"
        known = "" if hover else f"{r['drift_known']:.2%}, {r['drift_known_worst']:.2%}"
        legs, ends = (", ".join(f"{v:.2f}" for v in r[f"{what}_error_over_sigma"]) for what in ("leg", "end"))
        blind = " ".join(f"{name} {n}" for name, n in r["reasons"].items()) or "none"
        place = f"| {r['vehicle']} | {r['knows']} | {r['flights']} | {r['path_m']:.0f} | {drift} | {known} "
        cost = f"{r['cpu_ms']:.0f}, {r['cpu_ms'] / r['sift_ms']:.2f}"
        lines.append(f"{place}| {legs} ({r['legs']}) | {ends} | {blind} | {cost} |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[101, 102, 103])
    parser.add_argument("--vehicles", nargs="+", default=["copter", "leaning", "plane", "hover"])
    parser.add_argument("--knows", nargs="+", default=["map", "range", "map,range", "home"])
    parser.add_argument("--draws", type=int, default=3, help="draws of the autopilot's errors for each flight")
    parser.add_argument("--keep", type=Path, default=Path("odometry-flights"), help="folder that keeps rendered flights")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    rows: list[dict[str, Any]] = []
    for vehicle in options.vehicles:
        flights = [flight_of(vehicle, seed, options.keep) for seed in options.seeds]
        sift = float(np.median([sift_ms(flight) for flight in flights]))
        for knows in options.knows:
            some = [
                flown(flight, Errors(), 1000 * seed + draw, knows)
                for seed, flight in zip(options.seeds, flights, strict=True)
                for draw in range(options.draws)
            ]
            rows.append({"vehicle": vehicle, "knows": knows, "sift_ms": sift, **figures(some)})
            print(table(rows)[-1], flush=True)
    print("\n".join(table(rows)))
    if options.json:
        options.json.write_text(
            json.dumps({"schema": 1, "seeds": options.seeds, "rows": rows}, indent=1) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main()
