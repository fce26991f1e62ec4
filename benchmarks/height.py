"""Does the vertical protection level hold? `python -m benchmarks.height [--flights N] [--seed N] [--in-common SHARE] [--blind]`.

Flights of the filter of the autopilot's height alone (core/height.py): a barometer that is off at the start, walks, stretches
climbs, and in half of the flights drifts away by 20 m or jumps by as much; image fixes twice a second and a structure fix every
five seconds, whose heights have an error of the map in common and share the localiser's prior; of what image fixes get wrong
besides a share (`--in-common`) lasts while the same ground is in view. They are wrong as often as they claim, by anything up to
40 m, and then stay wrong in the same way with a probability of 0.5.

Prints for each kind of flight: epochs (every half second), fixes, wrong ones, misleading epochs (the stated height errs by more
than its level), hazardously misleading ones (beyond the alert limit, the level not), availability, medians of error and level,
and of the height that fixes correct, which localisers are told, median and 95 % of the error, and the share within two of its
1-sigmas. `--blind` judges the level that believes every fix.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, field, replace

import numpy as np

from visloc_companion.core.height import OVER_CLAIM, HeightFilter, HeightFix, news_of
from visloc_companion.core.lasting import apart_m
from visloc_companion.core.requests import height_sigma_m, least_height_sigma_m
from visloc_companion.core.separation import CORRELATION
from visloc_companion.core.settings import NavigatorSettings

STEP_S, DURATION_S = 0.5, 300.0
HEIGHT_M, CLIMB_M, CLIMB_PERIOD_S = 100.0, 40.0, 150.0
SCALE_SIGMA = 0.03
CLAIMS = (1e-4, 0.05)
REACH_M = 40.0
FAR_M, FROM_S = 20.0, 100.0
KINDS = ("calm", "drift", "jump", "few")
IN_COMMON = 0.8
GONE_BY_PER_S = 10.0 / apart_m(HEIGHT_M)
"""At 10 m/s."""


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


def flown(kind: str, seed: int, *, blind: bool = False, in_common: float = IN_COMMON) -> Tally:
    """One flight, with an epoch every half second."""
    settings, rng = NavigatorSettings(), np.random.default_rng(seed)
    offset = height_sigma_m(HEIGHT_M) * rng.standard_normal()
    scale, common = SCALE_SIGMA * rng.standard_normal(), settings.map_sigma_h_m * rng.standard_normal()
    sign = rng.choice([-1.0, 1.0])
    tally, wrong_by = Tally(), {"deep": None, "structure": None}
    stated_m, lasting, kept = HEIGHT_M, rng.standard_normal(), math.exp(-GONE_BY_PER_S * STEP_S)
    heights = HeightFilter(settings, 0, stated_m, height_sigma_m(HEIGHT_M))
    for k in range(1, round(DURATION_S / STEP_S)):
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
            fix, wrong_by[method] = _fix(t_s, k, method, at_m, errs, wrong_by[method], heights, rng)
            tally.n_fixes += 1
            tally.n_wrong += wrong_by[method] is not None
            if fix is not None:
                heights.observe(replace(fix, climbed_m=heights.climbed_m(stated_m)))
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
    method: str,
    heights_m: tuple[float, float],
    errs: float,
    wrong_by: float | None,
    heights: HeightFilter,
    rng: np.random.Generator,
) -> tuple[HeightFix | None, float | None]:
    """A fix as a localiser gives it: its own measurement, which `errs` by so many sigmas, weighed with the prior that it was
    given; and what it is wrong by."""
    seen_m, stated_m = heights_m
    claim = math.exp(rng.uniform(*np.log(CLAIMS)))
    wrong = rng.random() < (CORRELATION if wrong_by is not None else claim)
    wrong_by = (rng.uniform(-REACH_M, REACH_M) if wrong_by is None else wrong_by) if wrong else None
    sigma_m = rng.uniform(0.4, 1.5)
    measured_m = seen_m + (wrong_by or 0.0) + sigma_m * errs
    offset_m, var_m2 = heights.at(round(t_s * 1e9), stated_m)
    prior_m, prior_sigma_m = stated_m + offset_m, max(math.sqrt(var_m2), least_height_sigma_m(HEIGHT_M))
    whole = sigma_m**-2 + prior_sigma_m**-2
    given_m = (measured_m / sigma_m**2 + prior_m / prior_sigma_m**2) / whole
    news = news_of(given_m, whole**-0.5, prior_m, prior_sigma_m)
    if news is None:
        return None, wrong_by
    said = news[0] - stated_m, news[1], 0.0, method, claim
    return HeightFix(round(t_s * 1e9), tie, *said, GONE_BY_PER_S), wrong_by


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
    parser.add_argument("--blind", action="store_true")
    options = parser.parse_args()
    names = ("epochs", "fixes", "wrong", "misleading", "hmi", "availability", "error_median_m", "level_median_m")
    names = (*names, "corrected_median_m", "corrected_95_m", "within_2_sigma")
    print(f"| flight | {' | '.join(names)} |\n|{'---|' * (len(names) + 1)}")
    for kind in KINDS:
        tally = Tally()
        for flight in range(options.flights):
            tally.add(flown(kind, options.seed + flight, blind=options.blind, in_common=options.in_common))
        figures = tally.figures(options.alert_limit)
        print(f"| {kind} | {' | '.join(f'{figures[name]:.4g}' for name in names)} |")


if __name__ == "__main__":
    main()
