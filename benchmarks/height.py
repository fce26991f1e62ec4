"""Does the vertical protection level hold? `python -m benchmarks.height [--flights N] [--seed N] [--speed MPS] [--kinds K ...]`.

Flights of the filter of the autopilot's height alone (core/heights/height.py): a barometer that is off at the start, walks,
stretches climbs, and in half of the flights drifts away by 20 m or jumps by as much; image fixes twice a second and a structure
fix every five seconds, whose heights have an error of the map in common and share the localiser's prior; of what image fixes get
wrong besides a share (`--in-common`) lasts while the same ground is in view. They are wrong as often as they claim, by anything
up to 40 m, and then stay wrong in the same way over the same ground (same_ground.py): at `--speed 0` for the whole flight.

Prints for each kind of flight: epochs (every half second), fixes, wrong ones, misleading epochs (the stated height errs by more
than its level), hazardously misleading ones (beyond the alert limit, the level not), availability, medians of error and level,
and of the height that fixes correct, which localisers are told, median and 95 % of the error, and the share within two of its
1-sigmas.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.flown.same_ground import Match, lasts_m
from visloc_companion.core.filter.lasting import apart_m
from visloc_companion.core.filter.votes import spacing_m
from visloc_companion.core.heights.height import OVER_CLAIM, HeightFilter, HeightFix, news_of
from visloc_companion.core.requests import height_sigma_m, least_height_sigma_m
from visloc_companion.core.settings import NavigatorSettings

STEP_S, DURATION_S = 0.5, 300.0
HEIGHT_M, CLIMB_M, CLIMB_PERIOD_S = 100.0, 40.0, 150.0
SCALE_SIGMA = 0.03
CLAIMS = (1e-4, 0.05)
REACH_M = 40.0
FAR_M, FROM_S = 20.0, 100.0
KINDS = ("calm", "drift", "jump", "few")
IN_COMMON = 0.8


@dataclass(slots=True)
class Tally:
    """Counts, and of every epoch the error of the stated height and its level, and that of the corrected one and its 1-sigma."""

    n_fixes: int = 0
    n_wrong: int = 0
    errors: list[float] = field(default_factory=list)
    levels: list[float] = field(default_factory=list)
    left: list[tuple[float, float]] = field(default_factory=list)

    def add(self, other: Tally) -> None:
        """Count another flight, too."""
        self.n_fixes += other.n_fixes
        self.n_wrong += other.n_wrong
        self.errors += other.errors
        self.levels += other.levels
        self.left += other.left

    def figures(self, alert_limit_m: float) -> dict[str, float]:
        """What is printed."""
        error, level = np.abs(self.errors), np.array(self.levels)
        left_m, sigma_m = np.array(self.left).T
        return {
            "epochs": len(error),
            "fixes": self.n_fixes,
            "wrong": self.n_wrong,
            "misleading": int((error > level).sum()),
            "hmi": int(((error > alert_limit_m) & (level <= alert_limit_m)).sum()),
            "availability": float((level <= alert_limit_m).mean()),
            "error_median_m": float(np.median(error)),
            "level_median_m": float(np.median(level)),
            "corrected_median_m": float(np.median(np.abs(left_m))),
            "corrected_95_m": float(np.percentile(np.abs(left_m), 95)),
            "within_2_sigma": float((np.abs(left_m) <= 2 * sigma_m).mean()),
        }


@dataclass(frozen=True, slots=True)
class Flight:
    """What is flown, how fast to the north and how long; of what image fixes get wrong a share lasts over the same ground."""

    kind: str
    speed_mps: float = 10.0
    in_common: float = IN_COMMON
    duration_s: float = DURATION_S


def flown(flight: Flight, seed: int, *, blind: bool = False) -> Tally:
    """One flight, with an epoch every half second."""
    kind, in_common, gone_by_per_s = flight.kind, flight.in_common, flight.speed_mps / apart_m(HEIGHT_M)
    settings, rng = NavigatorSettings(), np.random.default_rng(seed)
    offset = height_sigma_m(HEIGHT_M) * rng.standard_normal()
    scale, common = SCALE_SIGMA * rng.standard_normal(), settings.map_sigma_h_m * rng.standard_normal()
    sign = rng.choice([-1.0, 1.0])
    tally, matches = Tally(), {method: Match(method) for method in ("deep", "structure")}
    stated_m, lasting, kept = HEIGHT_M, rng.standard_normal(), math.exp(-gone_by_per_s * STEP_S)
    heights = HeightFilter(settings, 0, stated_m, height_sigma_m(HEIGHT_M))
    for k in range(1, round(flight.duration_s / STEP_S)):
        t_s = k * STEP_S
        offset += settings.height_walk_m_per_sqrt_s * math.sqrt(STEP_S) * rng.standard_normal()
        offset += _fault_m(kind, t_s) * sign
        lasting = kept * lasting + math.sqrt(1 - kept**2) * rng.standard_normal()
        climbed = CLIMB_M * math.sin(2 * math.pi * t_s / CLIMB_PERIOD_S)
        stated_m, true_m = HEIGHT_M + climbed, HEIGHT_M + climbed + offset + scale * climbed
        for method, every in (("deep", 40 if kind == "few" else 1), ("structure", 10)):
            if k % every or (kind == "few" and method == "structure"):
                continue
            lasts, anew = (in_common * OVER_CLAIM, (1 - in_common) * OVER_CLAIM) if method == "deep" else (0.0, 1.0)
            errs = math.sqrt(lasts) * lasting + math.sqrt(anew) * rng.standard_normal()
            at_m = true_m + common, stated_m
            on_m = flight.speed_mps * STEP_S * every
            fix = _fix(t_s, k, matches[method], on_m, at_m, errs, heights, rng)
            tally.n_fixes += 1
            tally.n_wrong += matches[method].wrong_by is not None
            if fix is not None:
                at_ne_m = flight.speed_mps * t_s, 0.0
                ground = replace(fix, gone_by_per_s=gone_by_per_s, at_ne_m=at_ne_m, spacing_m=spacing_m(None, HEIGHT_M))
                heights.observe(replace(ground, climbed_m=heights.climbed_m(stated_m)))
        tally.errors.append(stated_m - true_m)
        tally.levels.append(_level_m(heights, round(t_s * 1e9), stated_m, settings, blind))
        offset_m, var_m2 = heights.at(round(t_s * 1e9), stated_m)
        tally.left.append((stated_m + offset_m - true_m, math.hypot(math.sqrt(var_m2), settings.map_sigma_h_m)))
    return tally


def _fault_m(kind: str, t_s: float) -> float:
    """What a fault adds to the barometer's error in this step."""
    if kind == "jump":
        return FAR_M if t_s == FROM_S else 0.0
    return FAR_M * STEP_S / 100.0 if kind == "drift" and FROM_S <= t_s < FROM_S + 100.0 else 0.0


def _fix(
    t_s: float,
    tie: int,
    match: Match,
    on_m: float,
    heights_m: tuple[float, float],
    errs: float,
    heights: HeightFilter,
    rng: np.random.Generator,
) -> HeightFix | None:
    """A fix as a localiser gives it, so far on from the last: its own measurement, which `errs` by so many sigmas, weighed with
    the prior that it was given."""
    seen_m, stated_m = heights_m
    claim = math.exp(rng.uniform(*np.log(CLAIMS)))
    wrong_by = match.look(on_m, lasts_m(HEIGHT_M), claim, rng, lambda: rng.uniform(-REACH_M, REACH_M, 1))
    sigma_m = rng.uniform(0.4, 1.5)
    measured_m = seen_m + (0.0 if wrong_by is None else float(wrong_by[0])) + sigma_m * errs
    offset_m, var_m2 = heights.at(round(t_s * 1e9), stated_m)
    prior_m, prior_sigma_m = stated_m + offset_m, max(math.sqrt(var_m2), least_height_sigma_m(HEIGHT_M))
    whole = sigma_m**-2 + prior_sigma_m**-2
    given_m = (measured_m / sigma_m**2 + prior_m / prior_sigma_m**2) / whole
    news = news_of(given_m, whole**-0.5, prior_m, prior_sigma_m)
    if news is None:
        return None
    return HeightFix(round(t_s * 1e9), tie, news[0] - stated_m, news[1], 0.0, match.method, claim)


def _level_m(heights: HeightFilter, t_ns: int, stated_m: float, settings: NavigatorSettings, blind: bool) -> float:
    if not blind:
        return heights.protection_level_m(t_ns, stated_m, HEIGHT_M)
    offset_m, var_m2 = heights.at(t_ns, stated_m)
    return abs(offset_m) + 4.42 * math.sqrt(var_m2 + settings.map_sigma_h_m**2)


def main() -> None:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=50, help="of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--alert-limit", type=float, default=NavigatorSettings().vertical_alert_limit_low_m)
    parser.add_argument(
        "--in-common", type=float, default=IN_COMMON, help="of the errors of image fixes, a share of the variance that they claim"
    )
    parser.add_argument("--speed", type=float, default=10.0, help="m/s")
    parser.add_argument("--seconds", type=float, default=DURATION_S)
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=KINDS)
    parser.add_argument("--blind", action="store_true", help="judge the level that believes every fix")
    options = parser.parse_args()
    names = ("epochs", "fixes", "wrong", "misleading", "hmi", "availability", "error_median_m", "level_median_m")
    names = (*names, "corrected_median_m", "corrected_95_m", "within_2_sigma")
    print(f"| flight | {' | '.join(names)} |\n|{'---|' * (len(names) + 1)}")
    for kind in options.kinds:
        flight, tally = Flight(kind, options.speed, options.in_common, options.seconds), Tally()
        for k in range(options.flights):
            tally.add(flown(flight, options.seed + k, blind=options.blind))
        figures = tally.figures(options.alert_limit)
        print(f"| {kind} | {' | '.join(f'{figures[name]:.4g}' for name in names)} |")


if __name__ == "__main__":
    main()
