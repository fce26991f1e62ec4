"""The error budget: what each source adds to the horizontal position, predicted from what is stated of it, and achieved.

    python -m benchmarks.error_budget [--vehicles copter plane] [--seeds 3] [--seeds-with-pictures 2] [--predicted] [--json FILE]

Predicted: evaluate/error_budget.py. Achieved: the same flight in closed loop (benchmarks/flown/error_budget_flights.py) clean and
with one source switched on, at its 1-sigma: map moved, frames stamped late, the matching's noise as fixes claim it, the compass
off; with pictures the lens longer or shorter and the camera tilted either way. The difference (or half of that between the two
ways) is the term: of a constant source its mean (over the ground, or over the body, in which it is constant), of the others its
root mean square. `propagation` is the clean flight's own error. `all`: every source drawn at random, errors of all outputs
against the truth. Seconds 55 to 115, GNSS jammed from 40.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from benchmarks.flown.error_budget_flights import (
    HEIGHT_M,
    JAM_S,
    LATENCY_S,
    RATE_HZ,
    Errors,
    Source,
    with_pictures,
    without_pictures,
)
from visloc_companion.core.camera.camera_time import SURE_S
from visloc_companion.core.integrity import HEIGHT_SHARE
from visloc_companion.core.requests import SIGMA_YAW_RAD
from visloc_companion.core.settings import CoreSettings
from visloc_companion.evaluate.closed_loop import map_sigma_m
from visloc_companion.evaluate.error_budget import Flown, Stated, Term, predicted, radial_m, total
from visloc_companion.sim.faults import CompassError, FaultSchedule, FocalError, MapShift, MountError, these
from visloc_companion.sim.setup import FIELD_OF_VIEW_RAD, SPEED_MPS, VehicleKind
from visloc_companion.types import FloatArray

SETTINGS = CoreSettings()
MAP_GSD_M = 0.5
LEANS = 60
"""Leans of a flight that the prediction goes through."""
SHARES = (0.68, 0.95)
HEADER = "| term | predicted: along, across m | 68 % m | 95 % m | achieved: along, across m | 68 % m | 95 % m | ratio |"
EXPLAINED = 1 / 3
"""A term that differs by more is marked."""


def main(argv: Sequence[str] | None = None) -> None:
    """Fly, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", nargs="+", choices=["copter", "plane"], default=["copter", "plane"])
    parser.add_argument("--seeds", type=int, default=3, help="flights with all sources, without pictures")
    parser.add_argument("--seeds-with-pictures", type=int, default=2, help="the same with pictures")
    parser.add_argument("--predicted", action="store_true", help="fly only the clean flight")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(argv)
    results = {}
    for vehicle in options.vehicles:
        seen = with_pictures(vehicle, 1, Source())
        stated, flown = stated_of(seen), flown_of(vehicle, seen)
        terms = predicted(flown, stated, SETTINGS.navigator)
        achieved = {} if options.predicted else achieved_terms(vehicle, stated)
        together = {} if options.predicted else all_sources(vehicle, stated, options.seeds, options.seeds_with_pictures)
        results[vehicle] = {
            "flown": asdict(flown),
            "stated": asdict(stated),
            "predicted": [asdict(term) for term in (*terms, total(terms))],
            "achieved": [asdict(term) for term in achieved.values()],
            "all": together,
            "fix_error_rms_m": rms(seen.fix_error_ne_m).tolist(),
        }
        print("\n".join(table(vehicle, flown, terms, achieved, together)), flush=True)
        if options.json:
            options.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


def stated_of(seen: Errors) -> Stated:
    """Configuration and constants of the core; the matching as fixes of a flight with pictures claim it, less the map's share."""
    map_m = map_sigma_m(MAP_GSD_M)
    matching_m = math.sqrt(max(0.0, float(np.mean(np.square(seen.claimed_m))) - map_m**2))
    weighed_m = math.sqrt(1 / float(np.mean(seen.claimed_m**-2.0)))
    half_view = (FIELD_OF_VIEW_RAD / 2, math.atan(0.75 * math.tan(FIELD_OF_VIEW_RAD / 2)))
    tilt_rad = SETTINGS.mount_sigma_rad
    return Stated(map_m, HEIGHT_SHARE, SURE_S, tilt_rad, SIGMA_YAW_RAD, matching_m, weighed_m, half_view)


def flown_of(vehicle: VehicleKind, seen: Errors) -> Flown:
    """As the clean flight was flown."""
    leans = tuple((float(roll), float(pitch)) for roll, pitch in seen.lean_rad[:: max(1, len(seen.lean_rad) // LEANS)])
    rate_hz = len(seen.fix_error_ne_m) / float(seen.t_s[-1] - seen.t_s[0])
    acceleration = float(np.hypot(*rms(seen.acceleration_ne_mps2)))
    return Flown(HEIGHT_M, SPEED_MPS[vehicle], leans, acceleration, min(RATE_HZ, rate_hz), LATENCY_S)


def achieved_terms(vehicle: VehicleKind, stated: Stated) -> dict[str, Term]:
    """Each source alone, at its 1-sigma."""
    claimed_m = math.hypot(stated.matching_m, stated.map_m)

    def blind(source: Source) -> Errors:
        return without_pictures(vehicle, 1, source, claimed_m)

    clean = blind(Source())
    shift = (stated.map_m, stated.map_m)
    compass = these(CompassError(JAM_S, stated.heading_rad, 5.0))

    def focal(sign: int) -> FaultSchedule:
        return these(FocalError(sign * stated.focal_share))

    def mount(sign: int) -> FaultSchedule:
        return these(MountError(sign * stated.tilt_rad, sign * stated.tilt_rad))

    terms = [
        term("map", mean(blind(Source(map_ne_m=shift)).error_ne_m - clean.error_ne_m)),
        term("calibration", either_way(lambda sign: with_pictures(vehicle, 1, Source(focal(sign))))),
        term("time", body_mean(blind(Source(time_s=stated.time_s)), clean)),
        term("attitude: tilt", either_way(lambda sign: with_pictures(vehicle, 1, Source(mount(sign))))),
        term("attitude: heading", body_rms(blind(Source(compass)), clean)),
        term("matching", body_rms(blind(Source(matching_m=stated.matching_m)), clean)),
        term("propagation", rms(clean.along_across(clean.error_ne_m))),
    ]
    return {each.name: each for each in terms}


def all_sources(vehicle: VehicleKind, stated: Stated, blind: int, seeing: int) -> dict[str, list[float]]:
    """Radial errors (68 and 95 %) of flights with every source drawn from what is stated; without pictures calibration and tilt
    are left out, with them the matching is the real one."""
    claimed_m = math.hypot(stated.matching_m, stated.map_m)
    flown: dict[str, Callable[[int], Errors]] = {
        "without pictures": lambda seed: without_pictures(vehicle, seed, drawn(stated, seed, pictures=False), claimed_m),
        "with pictures": lambda seed: with_pictures(vehicle, seed, drawn(stated, seed, pictures=True)),
    }
    figures = {}
    for (name, fly), count in zip(flown.items(), (blind, seeing), strict=True):
        if count:
            radial = np.concatenate([np.hypot(*fly(seed).error_ne_m.T) for seed in range(2, 2 + count)])
            figures[name] = [float(np.percentile(radial, 100 * share)) for share in SHARES]
    return figures


def drawn(stated: Stated, seed: int, *, pictures: bool) -> Source:
    """All sources, from the seed."""
    rng = np.random.default_rng([seed, 79])
    north, east, focal, roll, pitch, yaw, late = rng.standard_normal(7)
    compass = CompassError(JAM_S, float(yaw) * stated.heading_rad, 5.0)
    late_s, shift = float(late) * stated.time_s, (float(north) * stated.map_m, float(east) * stated.map_m)
    if not pictures:
        return Source(these(compass), shift, late_s, stated.matching_m)
    mount = MountError(float(roll) * stated.tilt_rad, float(pitch) * stated.tilt_rad)
    return Source(these(compass, MapShift(*shift), FocalError(float(focal) * stated.focal_share), mount), time_s=late_s)


def mean(vectors: FloatArray) -> FloatArray:
    """(2,) magnitudes of the mean of (N, 2)."""
    return np.asarray(np.abs(np.nanmean(vectors, axis=0)))


def rms(vectors: FloatArray) -> FloatArray:
    """(2,) root mean squares of (N, 2)."""
    return np.asarray(np.sqrt(np.nanmean(np.square(vectors), axis=0)))


def body_mean(wrong: Errors, clean: Errors) -> FloatArray:
    """Mean difference along and across the course."""
    return mean(wrong.along_across(wrong.error_ne_m) - clean.along_across(clean.error_ne_m))


def either_way(fly: Callable[[int], Errors]) -> FloatArray:
    """Half of the mean difference along and across the course between a flight with a source and one with its opposite: two
    flights whose pictures differ match differently, and what both signs have in common is not the source's."""
    one, other = fly(1), fly(-1)
    n = min(len(one.error_ne_m), len(other.error_ne_m))
    return mean((one.along_across(one.error_ne_m)[:n] - other.along_across(other.error_ne_m)[:n]) / 2)


def body_rms(wrong: Errors, clean: Errors) -> FloatArray:
    """Root mean square of the difference along and across the course."""
    return rms(clean.along_across(wrong.error_ne_m - clean.error_ne_m))


def term(name: str, sigmas_m: FloatArray) -> Term:
    """A term from its two 1-sigmas."""
    return Term(name, float(sigmas_m[0]), float(sigmas_m[1]))


def table(
    vehicle: str, flown: Flown, terms: Sequence[Term], achieved: dict[str, Term], together: dict[str, list[float]]
) -> list[str]:
    """Lines of a vehicle's table."""
    roll, pitch = rms(np.array(flown.leans_rad))
    lines = [
        f"\n{vehicle}: {flown.height_m:.0f} m, {flown.speed_mps:.0f} m/s, leaning {math.degrees(pitch):.1f} degrees "
        f"forward and {math.degrees(roll):.1f} sideways (rms), {flown.fix_rate_hz:.1f} fixes a second after "
        f"{1e3 * flown.latency_s:.0f} ms\n",
        HEADER,
        f"|{'---|' * (HEADER.count('|') - 1)}",
    ]
    rows = [*terms, total(terms)]
    got = dict(achieved) | ({"total": total(list(achieved.values()))} if achieved else {})
    for row in rows:
        share, other = [radial_m(row, s) for s in SHARES], got.get(row.name)
        cells = f"| {row.name} | {row.along_m:.2f}, {row.across_m:.2f} | {share[0]:.2f} | {share[1]:.2f} |"
        if other is None:
            lines.append(f"{cells} | | | |")
            continue
        found = [radial_m(other, s) for s in SHARES]
        ratio = found[1] / share[1]
        mark = "" if abs(ratio - 1) <= EXPLAINED else " *"
        lines.append(f"{cells} {other.along_m:.2f}, {other.across_m:.2f} | {found[0]:.2f} | {found[1]:.2f} | {ratio:.2f}{mark} |")
    whole = radial_m(total(terms), SHARES[1])
    for name, (two_thirds, most) in together.items():
        lines.append(f"| all, {name} | | | | | {two_thirds:.2f} | {most:.2f} | {most / whole:.2f} |")
    return lines


if __name__ == "__main__":
    main()
