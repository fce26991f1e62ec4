"""What it costs and saves that all fixes over one ground are one witness against GNSS (core/satellites/gnss_witness.py).

python -m benchmarks.gnss_witness [--claim 0.01] [--clean 16] [--drags 100] [--speeds 3 20] [--thresholds 9 10.5 14 18]

Two kinds of flights with fixes and no odometry (gnss_flights.py), each with every fix a witness of its own and with one a ground:
half an hour with nothing wrong but matches, which are so as often as they claim and last over the ground; and drags of 1 m/s in
all directions, with single wrong matches as in gnss_roc.py. Prints for each threshold false alarms in 10 h and the seconds until
a drag is declared.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence

import numpy as np

from benchmarks.gnss_roc import CLEAN_S, SCORE_SEED, Series, alarms, quantiles, statistics_of
from benchmarks.gnss_runs.gnss_flights import Flight, World
from visloc_companion.sim import faults
from visloc_companion.sim.faults import FaultSchedule

BEGINS_S, WATCHED_S = 120.0, 60.0
DRAG_MPS = 1.0
DRAG_SEED = SCORE_SEED + 5000
NAME = "vision"


def clean(world: World, n: int, duration_s: float, *, grounds: bool) -> list[Series]:
    """Flights beside a true GNSS."""
    flights = (Flight(SCORE_SEED + k, FaultSchedule(), duration_s, world) for k in range(n))
    return [statistics_of(flight, grounds=grounds) for flight in flights]


def drags(world: World, n: int, *, grounds: bool) -> list[Series]:
    """Flights beside one that is dragged, each in another direction."""
    flights = (
        Flight(DRAG_SEED + k, faults.slow_drag(BEGINS_S, DRAG_MPS, 0.1 * k), BEGINS_S + WATCHED_S, world) for k in range(n)
    )
    return [statistics_of(flight, grounds=grounds) for flight in flights]


def after_s(series: Series, threshold: float) -> float:
    """Seconds from the beginning of a drag until its statistic is above a threshold; WATCHED_S where it never is."""
    hit = np.nonzero(series.log_r[NAME][round(BEGINS_S) :] > threshold)[0]
    return float(hit[0]) if len(hit) else WATCHED_S


def rows(quiet: Sequence[Series], dragged: Sequence[Series], thresholds: Sequence[float]) -> list[str]:
    """A row of the table for each threshold."""
    hours = math.fsum(len(series.log_r[NAME]) for series in quiet) / 3600
    out = []
    for threshold in thresholds:
        n = sum(alarms(series.log_r[NAME], threshold) for series in quiet)
        delays = quantiles([after_s(series, threshold) for series in dragged])
        assert delays is not None
        out.append(f"{threshold:g} | {10 * n / hours:.2f} ({n} in {hours:g} h) | {', '.join(f'{v:.1f}' for v in delays)} |")
    return out


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--claim", type=float, default=0.01, help="share of the matches that is wrong, as each fix claims")
    parser.add_argument("--clean", type=int, default=16, help="flights with nothing else wrong")
    parser.add_argument("--clean-s", type=float, default=CLEAN_S, help="how long each of them is")
    parser.add_argument("--drags", type=int, default=100)
    parser.add_argument("--speeds", type=float, nargs=2, default=(3.0, 20.0), metavar=("LEAST", "MOST"), help="m/s")
    parser.add_argument("--thresholds", type=float, nargs="+", default=(9.0, 10.5, 14.0, 18.0))
    args = parser.parse_args(argv)
    speed_mps = (args.speeds[0], args.speeds[1])
    right = World(odometry=False, wrong_share=args.claim, speed_mps=speed_mps)
    wrong = World(odometry=False, wrong_share=args.claim, speed_mps=speed_mps, lasting_wrong=True)
    print("| witnesses | threshold | false alarms in 10 h | drag declared after s: median, 95 %, worst |\n|---|---|---|---|")
    for word, grounds in (("each fix", False), ("each ground", True)):
        quiet, dragged = clean(wrong, args.clean, args.clean_s, grounds=grounds), drags(right, args.drags, grounds=grounds)
        print("\n".join(f"| {word} | {row}" for row in rows(quiet, dragged, args.thresholds)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
