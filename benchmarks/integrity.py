"""Does the protection level hold? `python -m benchmarks.integrity [--flights N] [--seconds S] [--seed N] ...`.

Flights of the filter alone, without pictures: truth, accelerations with the error that the daemon learns them to have (or the
autopilot's velocity: its slow error, and what it learns of our own injections), and fixes with the covariance and the probability
of being wrong that they claim. They are wrong as often as they claim; of what is wrong half has come to an end after each way of
`--lasts` metres (of shapes no more than half from one answer to the next), so a vehicle that stays has the same answer again. A
wrong fix lies anywhere in the search region.

Prints for each kind of flight: epochs (every fix and every second), fixes, wrong ones and those of them that the filter took,
misleading epochs (error beyond the protection level), hazardously misleading ones (error beyond the alert limit, the level not),
availability (level within the limit), medians of error and level. `--blind` judges the level that believes every match: 4.80
sigma of the filter alone.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.flown.claims import claimed
from benchmarks.flown.integrity_kinds import ODOMETRY, VOTES, Flight, Tally, Vote
from benchmarks.flown.same_ground import Match, anywhere_m, lasts_m
from visloc_companion.core.covariance import largest_sigma_m
from visloc_companion.core.estimator import PositionFilter
from visloc_companion.core.filter.belief import seeded
from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.propagation import INERTIAL_WALK_MPS_PER_SQRT_S, Drive
from visloc_companion.core.odometry_aiding import OdometryAiding
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.geo import wgs84
from visloc_companion.sim.odometry_model import OdometryModel
from visloc_companion.types import Accepted, Fix, FloatArray, GeoPoint

ORIGIN = GeoPoint(59.3, 18.1, 40.0)
DT_S = 0.1
HEIGHT_M = 100.0
LATENCY_NS = 250_000_000
FACTOR = math.sqrt(2 * math.log(1e5))
TILT_RAD = math.radians(1.0)
SIGMA_A_MPS2 = 0.1
BANDWIDTH_RADPS, DAMPING = 0.5, 0.8
"""How the autopilot's own filter follows what we inject: an alpha-beta filter."""
FRAME_STEPS = 2


@dataclass(slots=True)
class Source:
    """A vote's state within a flight: whether it is silent, what it makes of the ground, and when it looked last."""

    vote: Vote
    match: Match
    silent_until_s: float = -1.0
    looked_s: float = 0.0


def flown(flight: Flight, seed: int, settings: NavigatorSettings | None = None, *, blind: bool = False) -> Tally:
    """One flight, with an epoch at every fix and every second."""
    settings = settings or NavigatorSettings()
    rng = np.random.default_rng(seed)
    truth, heading = np.zeros(2), 0.0
    bias = flight.velocity_sigma_mps * rng.standard_normal(2)
    slow = SIGMA_A_MPS2 * rng.standard_normal(2)
    drive = Drive.INERTIAL if flight.inertial else Drive.FED_BACK
    map_error = settings.map_sigma_m * rng.standard_normal(2)
    autopilot_p, autopilot_dv = map_error.copy(), np.zeros(2)
    sources = [Source(VOTES[name], Match(VOTES[name].method)) for name in flight.votes if name in VOTES]
    drawn, aiding = OdometryModel.drawn(rng), OdometryAiding()
    eyes = drawn if ODOMETRY in flight.votes else None
    position_filter = _started(settings, truth + map_error, rng)
    tally = Tally()
    a, a_slow = math.exp(-DT_S / settings.velocity_correlation_s), math.exp(-DT_S / settings.acceleration_correlation_s)
    walk, sigma_a_mps2 = INERTIAL_WALK_MPS_PER_SQRT_S * math.sqrt(DT_S), SIGMA_A_MPS2 if flight.inertial else None
    for k in range(1, round(flight.duration_s / DT_S) + 1):
        t_s = k * DT_S
        heading += 0.05 * math.sin(t_s / 20) * DT_S
        step = flight.speed_mps * DT_S * np.array([math.cos(heading), math.sin(heading)])
        truth = truth + step
        if flight.inertial:
            bias = bias + slow * DT_S + walk * rng.standard_normal(2)
            slow = a_slow * slow + SIGMA_A_MPS2 * math.sqrt(1 - a_slow**2) * rng.standard_normal(2)
            v = step / DT_S + bias
        else:
            bias = a * bias + flight.velocity_sigma_mps * math.sqrt(1 - a * a) * rng.standard_normal(2)
            v = step / DT_S + bias + autopilot_dv
        position_filter.drive(
            Velocity(_ns(t_s), (float(v[0]), float(v[1]), 0.0), HEIGHT_M, settings.velocity_sigma_aiding_mps, drive, SIGMA_A_MPS2)
        )
        if eyes is not None and k % FRAME_STEPS == 0:
            seen = eyes.look(_ns(t_s), truth, rng)
            motion = None if seen is None else aiding.on_odometry(seen, inertial_mps2=sigma_a_mps2).of_filter
            if motion is not None:
                position_filter.observe_motion(motion)
        observed = [_observe(position_filter, source, t_s, truth + map_error, flight, tally, rng) for source in sources]
        state = position_filter.at(_ns(t_s))
        ours = np.array(state.p_ned_m[:2])
        autopilot_p, autopilot_dv = _followed(autopilot_p + step, autopilot_dv, ours)
        if any(observed) or k % 10 == 0:
            tally.errors.append(float(np.hypot(*(ours - truth))))
            level_m = FACTOR * largest_sigma_m(state.cov_ne_m2) if blind else position_filter.protection_level_m(_ns(t_s))
            tally.levels.append(level_m)
    return tally


def _started(settings: NavigatorSettings, at: FloatArray, rng: np.random.Generator) -> PositionFilter:
    start = at + settings.seed_sigma_m * rng.standard_normal(2)
    belief = seeded(
        0,
        (float(start[0]), float(start[1])),
        settings.seed_sigma_m,
        settings.velocity_sigma_aiding_mps,
        Drive.FED_BACK,
        settings=settings,
    )
    still = Velocity(0, (0.0, 0.0, 0.0), HEIGHT_M, settings.velocity_sigma_aiding_mps, Drive.FED_BACK)
    return PositionFilter(settings, ORIGIN, belief, still)


def _followed(p: FloatArray, dv: FloatArray, injected: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The autopilot's position, and the error of its velocity that our injections cause, a step later."""
    innovation = injected - p
    gain = BANDWIDTH_RADPS * DT_S
    return p + dv * DT_S + 2 * DAMPING * gain * innovation, (1 - gain * DAMPING) * dv + gain * BANDWIDTH_RADPS * innovation


def _observe(
    position_filter: PositionFilter,
    source: Source,
    t_s: float,
    seen: FloatArray,
    flight: Flight,
    tally: Tally,
    rng: np.random.Generator,
) -> bool:
    """Let a vote answer where it is its turn; True where it did."""
    vote = source.vote
    if round(t_s / DT_S) % round(vote.period_s / DT_S) or t_s < source.silent_until_s:
        return False
    if rng.random() < vote.outage_share * vote.period_s / 10:
        source.silent_until_s = t_s + 10.0
        return False
    claim = claimed(rng)
    way_m, source.looked_s = flight.speed_mps * (t_s - source.looked_s), t_s
    wrong_by_m = source.match.look(way_m, flight.lasts_m, claim, rng, lambda: _anywhere(position_filter, t_s, rng))
    sigma = float(rng.uniform(*vote.sigma_m))
    at = seen + sigma * rng.standard_normal(2) + (0.0 if wrong_by_m is None else wrong_by_m)
    outcome = position_filter.observe(_fix(t_s, at, sigma, claim, vote.method, tally.n_fixes))
    wrong, taken = wrong_by_m is not None, isinstance(outcome, Accepted)
    tally.n_fixes += 1
    tally.n_wrong += wrong
    tally.n_wrong_taken += wrong and taken
    tally.n_rejected += not taken
    return True


def _anywhere(position_filter: PositionFilter, t_s: float, rng: np.random.Generator) -> FloatArray:
    """(2,) from the middle of the search region to anywhere in it."""
    state = position_filter.at(_ns(t_s))
    return anywhere_m(3 * math.hypot(largest_sigma_m(state.cov_ne_m2), HEIGHT_M * TILT_RAD), rng)


def _fix(t_s: float, ne_m: FloatArray, sigma_m: float, claim: float, method: str, number: int) -> Fix:
    place = wgs84.geo_from_ned((float(ne_m[0]), float(ne_m[1]), -HEIGHT_M), ORIGIN)
    cov = ((sigma_m**2, 0.0), (0.0, sigma_m**2))
    t_ns = _ns(t_s)
    return Fix(t_ns + LATENCY_NS, t_ns, number, number, method, place, (1.0, 0.0, 0.0, 0.0), cov, 2.0, 0.1, claim, 5.0)


def _ns(t_s: float) -> int:
    return round(t_s * 1e9)


def kinds(args: argparse.Namespace) -> Iterator[tuple[str, Flight, NavigatorSettings]]:
    """The kinds of flight, by name."""
    for speed in args.speeds:
        for votes in args.votes:
            flight = Flight(speed, tuple(votes.split("+")), args.lasts, args.velocity_sigma, args.seconds, not args.fed_back)
            settings = replace(NavigatorSettings(), velocity_sigma_aiding_mps=args.velocity_sigma)
            yield f"{votes}, {speed:.0f} m/s", flight, settings


def main(argv: Sequence[str] | None = None) -> None:
    """Fly, count, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=40, help="of each kind")
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--speeds", type=float, nargs="*", default=[10.0, 25.0])
    parser.add_argument(
        "--votes", nargs="*", default=["image", "image+odometry", "image+structure+odometry", "image+structure+terrain+odometry"]
    )
    parser.add_argument("--lasts", type=float, default=lasts_m(HEIGHT_M), help="metres")
    parser.add_argument("--velocity-sigma", type=float, default=NavigatorSettings().velocity_sigma_aiding_mps)
    parser.add_argument("--alert-limit", type=float, default=25.0)
    parser.add_argument("--fed-back", action="store_true", help="ride on the autopilot's velocity, not on accelerations")
    parser.add_argument("--blind", action="store_true")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args(argv)
    rows = []
    print("| flights | epochs | fixes | wrong | taken | misleading | HMI | available | error 50/95 m | level 50 m | ratio |")
    print("|" + "---|" * 11)
    for name, flight, settings in kinds(args):
        tally = Tally()
        for k in range(args.flights):
            tally.add(flown(flight, 1000 * args.seed + k, settings, blind=args.blind))
        f = tally.figures(args.alert_limit)
        rows.append({"flights": name, **asdict(flight), **f})
        print(
            f"| {name} | {f['epochs']} | {f['fixes']} | {f['wrong']} | {f['wrong_taken']} | {f['misleading']} | {f['hmi']} | "
            f"{100 * f['availability']:.2f} % | {f['error_median_m']:.2f} / {f['error_p95_m']:.2f} | {f['level_median_m']:.1f} | "
            f"{f['level_over_error']:.1f} |",
            flush=True,
        )
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
