"""What a protection level is made of, and what pushes it beyond its limit: flights over NAIP, term by term and phase by phase.

    python -m benchmarks.level_parts [--jobs N] [--method deep] [--every S] [--json FILE]

Flies what benchmarks.flights flies over NAIP and notes what the navigator made each level of (benchmarks/flown/level_terms.py).
Prints a row for each phase of a flight: whether GNSS was trusted, and whether the vehicle had turned by more than TURNED_DEG
since the start. `within` is the share of its levels within the limit, with what GNSS tells of fixes (core/filter/by_gnss.py) and
without. Terms are means over the phase and add up to the mean level; `claims` is the median 1-sigma of its fixes, `tilt` that of
what was known of the camera's tilt before each. `--every` prints the levels of each flight, one in so many seconds. `--json`
keeps the terms of every epoch. Needs ../shared/data/naip.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.flights import NAIP_FLIGHTS, naip_base
from benchmarks.flown.level_terms import Terms, noted, of_levels
from benchmarks.pages.scenario_page import table
from visloc_companion.app.with_parent import end_with_parent
from visloc_companion.evaluate.campaign import FlightSpec, fly_spec
from visloc_companion.evaluate.closed_loop import ALERT_LIMIT_M, FlownScenario, map_sigma_m
from visloc_companion.evaluate.record import FlightRecord
from visloc_companion.localise.registry import METHODS
from visloc_companion.maps.pack import PackMap
from visloc_companion.types import FloatArray, LocaliseRequest, Verdict

TURNED_DEG = 20.0
COURSE_M = 5.0
"""A course is that of so much way."""
PHASES = ("GNSS trusted", "GNSS trusted, turned", "without", "without, turned")
TERMS = ("own", "map", "doubts", "wrong fixes", "GNSS", "age")
COLUMNS = (
    *("flight", "phase", "s", "within", "by fixes alone", "level m", *(f"{term} m" for term in TERMS)),
    *("error 50, max m", "of level", "claims m", "tilt °"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """A flight's epochs (N,): time s, level and its terms (N, 6), error, m; which phase each is of. What its fixes claim and what
    was known of the tilt (rad) before each, both (K, 2) with the time."""

    name: str
    t_s: FloatArray
    level_m: FloatArray
    terms_m: FloatArray
    error_m: FloatArray
    phase: NDArray[np.int64]
    claims: FloatArray
    tilts: FloatArray


def main() -> None:
    """Fly and print."""
    args = parse_args()
    with tempfile.TemporaryDirectory() as folder:
        base = naip_base(Path(folder))
        if base is None:
            raise SystemExit("needs ../shared/data/naip")
        specs = [replace(base, method=args.method, **each) for each in NAIP_FLIGHTS]
        with ProcessPoolExecutor(args.jobs, mp_context=get_context("spawn"), initializer=end_with_parent) as pool:
            flights = list(pool.map(flown, specs))
    print(table(COLUMNS, [cells for flight in flights for cells in rows(flight)]))
    for flight in flights if args.every else []:
        print(f"\n{flight.name}\n\n{table(('at s', 'phase', 'level m', *TERMS, 'error m'), moments(flight, args.every))}")
    if args.json:
        kept = {
            flight.name: np.column_stack([flight.t_s, flight.terms_m, flight.error_m]).round(3).tolist() for flight in flights
        }
        args.json.write_text(json.dumps({"columns": ["t_s", *TERMS, "error_m"], "flights": kept}) + "\n", encoding="utf-8")


def parse_args() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--method", default="deep", choices=METHODS)
    parser.add_argument("--every", type=float, default=0.0, help="seconds")
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


def flown(spec: FlightSpec) -> Levels:
    """One flight, on one thread, in a process of its own."""
    cv2.setNumThreads(1)
    with noted(map_sigma_m(PackMap.open(spec.pack, verify_hashes=False).gsd_m)) as terms:
        return levels(spec, fly_spec(spec), terms)


def levels(spec: FlightSpec, flight: FlownScenario, terms: Sequence[Terms]) -> Levels:
    """The epochs that have a level."""
    record, low = flight.record, f", low ({spec.height_m:.0f} m)" if spec.height_m else ""
    stated = np.isfinite(record.protection_level_m)
    trusted = record.while_verdict(Verdict.OK)
    phase = np.where(trusted, 0, 2) + turned(record)
    asked = [(e.now_ns, e.command.prior.tilt) for e in flight.log.entries if isinstance(e.command, LocaliseRequest)]
    tilts = [((now_ns - record.t0_ns) * 1e-9, tilt.sigma_rad) for now_ns, tilt in asked if tilt is not None]
    return Levels(
        f"{spec.scenario}, {spec.vehicle}{low}",
        record.t_s[stated],
        record.protection_level_m[stated],
        np.array(of_levels(terms, record.protection_level_m[stated].tolist()))[:, 1:],
        record.error_m[stated],
        phase[stated],
        np.array([(fix.t_s, fix.sigma_m) for fix in record.fixes]).reshape(-1, 2),
        np.array(tilts).reshape(-1, 2),
    )


def turned(record: FlightRecord) -> NDArray[np.bool_]:
    """(N,) whether the true course has ever been another than at the start."""
    way = record.truth_ned_m[:, :2]
    ahead = np.searchsorted(np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))]), COURSE_M)
    first = way[ahead] - way[0]
    courses = np.zeros(len(way))
    for k in range(ahead, len(way)):
        east, north = (way[k] - way[max(0, k - ahead)])[::-1]
        courses[k] = abs(math.remainder(math.atan2(east, north) - math.atan2(first[1], first[0]), math.tau))
    return np.asarray(np.maximum.accumulate(courses) > math.radians(TURNED_DEG))


def rows(flight: Levels) -> list[list[str]]:
    """The phases of a flight that there were, and all of it."""
    which = [(PHASES[k], flight.phase == k) for k in range(len(PHASES))]
    return [row(flight, name, at) for name, at in [*which, ("all", np.ones(len(flight.t_s), np.bool_))] if at.any()]


def row(flight: Levels, phase: str, at: NDArray[np.bool_]) -> list[str]:
    """The epochs (N,) of a phase."""
    error, level = flight.error_m[at], flight.level_m[at]
    span = flight.t_s[at]

    def median(values: FloatArray, factor: float = 1.0) -> str:
        within = np.isin(np.searchsorted(flight.t_s, values[:, 0]), np.flatnonzero(at))
        return f"{factor * np.median(values[within, 1]):.2f}" if within.any() else "–"

    return [
        flight.name,
        phase,
        f"{span[0]:.0f} to {span[-1]:.0f}",
        f"{100 * np.mean(level <= ALERT_LIMIT_M):.1f} %",
        f"{100 * np.mean(by_fixes_m(flight)[at] <= ALERT_LIMIT_M):.1f} %",
        f"{level.mean():.1f}",
        *(f"{term:.1f}" for term in flight.terms_m[at].mean(axis=0)),
        f"{np.nanmedian(error):.1f}, {np.nanmax(error):.1f}",
        f"{np.nanmax(error / level):.2f}",
        median(flight.claims),
        median(flight.tilts, math.degrees(1.0)),
    ]


def by_fixes_m(flight: Levels) -> FloatArray:
    """(N,) what the levels would be without GNSS."""
    *_, gnss_m, age_m = flight.terms_m.T
    return flight.level_m * (1 - gnss_m / (flight.level_m - age_m))


def moments(flight: Levels, every_s: float) -> list[list[str]]:
    """The first epoch of each so many seconds."""
    _, first = np.unique(np.floor(flight.t_s / every_s), return_index=True)
    return [
        [
            f"{flight.t_s[k]:.0f}",
            PHASES[flight.phase[k]],
            f"{flight.level_m[k]:.1f}",
            *(f"{term:.1f}" for term in flight.terms_m[k]),
            f"{flight.error_m[k]:.1f}",
        ]
        for k in first.tolist()
    ]


if __name__ == "__main__":
    main()
