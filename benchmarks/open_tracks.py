"""Look-alike ground, flown many times without pictures: does the navigator find its place, how soon, and is it ever another?

    python -m benchmarks.open_tracks [--flights 1000] [--seed 1] [--only KIND ...] [--declined] [--json FILE]

A vehicle comes back to where it can see, its position known to SIGMA_M, and flies on straight at SPEED_MPS; each second a frame
is answered. Dead reckoning errs by a constant velocity (1-sigma DRIFT_MPS). The ground is squares of BLOCK_M in LETTERS kinds; a
frame sees one footprint, and the search lists the places where most of it is the same, the likelier the more, with noise; the
right place is missing for a stretch of ground now and then, and some frames tell nothing. What is listed alone is a fix today.

    blocks     three kinds in random order
    rows       one kind, and something else in one square of eight
    periodic   one kind
    outage     as blocks, with no answer for OUTAGE_S every so often
    changed    as blocks, the right place missing in half of all stretches

`alone`: only frames that show one place (the behaviour without hypotheses); `tracks`: core/places/open_tracks.py, too. Flights,
found and wrong, seconds until the first fix (median and 95 % of those that were found). The same flights for both; `resolved`
counts those whose first fix came of hypotheses, and how many of them were wrong.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from visloc_companion.core.places.open_tracks import OpenTracks
from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.types import Fix, FloatArray, FrameRef, GeoPoint, LocaliseRequest, NoFix, OpenPlace, PosePrior

KINDS: Final = ("blocks", "rows", "periodic", "outage", "changed")
ORIGIN = GeoPoint(47.0, 8.0, 400.0)
LEVEL = (1.0, 0.0, 0.0, 0.0)
BLOCK_M, FOOTPRINT_M, LETTERS, STRAY = 60.0, 60.0, 3, 0.125
SIGMA_M, SPEED_MPS, DRIFT_MPS, SECONDS = 30.0, 10.0, 0.5, 60
NATS, NOISE_NATS, PLACE_SIGMA_M, LISTED, LEAST = 12.0, 0.3, 0.7, 5, 1e-3
MISSING, MISSING_CHANGED, MUTE, OUTAGE_S = 0.08, 0.5, 0.1, 20
MAX_WRONG, FAR_M, S = 0.05, 15.0, 1_000_000_000

HEADER = (
    "| ground | flights | alone: found | wrong | s, median | 95 % | tracks: found | wrong | s, median | 95 % | resolved | wrong |"
)


@dataclass(frozen=True, slots=True)
class Outcome:
    """When the first fix came (s), and how far off it was."""

    found_s: float | None
    off_m: float | None


def main(argv: Sequence[str] | None = None) -> None:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=1000, help="of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--declined", action="store_true", help="no frame is a fix alone: a harder test of the hypotheses")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(argv)
    print(f"{HEADER}\n|{'---|' * (HEADER.count('|') - 1)}")
    results: dict[str, Any] = {}
    for kind in options.only:
        limit, draws = (
            -1.0 if options.declined else MAX_WRONG,
            ((options.seed, KINDS.index(kind), k) for k in range(options.flights)),
        )
        pairs = [flown(kind, np.random.default_rng(draw), limit) for draw in draws]
        resolved = [after for before, after in pairs if after != before]
        results[kind] = {name: figures([pair[i] for pair in pairs]) for i, name in enumerate(("alone", "tracks"))}
        results[kind]["resolved"] = {"n": len(resolved), "wrong": figures(resolved)["wrong"]}
        cells = [text for part in results[kind].values() for text in part.values()]
        print("| " + " | ".join([kind, str(options.flights), *map(str, cells)]) + " |", flush=True)
    if options.json:
        options.json.write_text(json.dumps({"schema": 1, "results": results}, indent=1), encoding="utf-8")


def figures(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Found right, found wrong, and when."""
    right = [o.found_s for o in outcomes if o.found_s is not None and o.off_m is not None and o.off_m <= FAR_M]
    wrong = sum(o.off_m is not None and o.off_m > FAR_M for o in outcomes)
    median, late = (round(float(np.percentile(right, q)), 1) if right else None for q in (50, 95))
    return {"found": len(right), "wrong": wrong, "median_s": median, "p95_s": late}


def flown(kind: str, rng: np.random.Generator, max_wrong: float = MAX_WRONG) -> tuple[Outcome, Outcome]:
    """One flight, judged by frames that show one place alone, and by the hypotheses as well; a fix may claim `max_wrong`."""
    letters = _letters(kind, rng)
    course, drift = rng.uniform(-math.pi, math.pi), rng.normal(0, DRIFT_MPS, 2)
    v = SPEED_MPS * np.array([math.cos(course), math.sin(course)])
    start = rng.uniform(0, BLOCK_M, 2)
    off = rng.normal(0, SIGMA_M, 2)
    tracks = OpenTracks()
    missing, alone, by_tracks = False, Outcome(None, None), Outcome(None, None)
    share = MISSING_CHANGED if kind == "changed" else MISSING
    for t_s in range(SECONDS):
        for tenth in range(10):
            tracks.moving(t_s * S + tenth * S // 10, (float(v[0] + drift[0]), float(v[1] + drift[1])))
        at = start + v * t_s
        if t_s % round(FOOTPRINT_M / SPEED_MPS) == 0:
            missing = bool(rng.random() < share)
        silent = kind == "outage" and (t_s // 5) % (1 + OUTAGE_S // 5) != 0
        if silent or rng.random() < MUTE:
            continue
        sigma_m = math.hypot(SIGMA_M, DRIFT_MPS * t_s)
        believed = at + off + drift * t_s
        places = seen_at(letters, at, believed, sigma_m, missing, rng)
        if not places:
            continue
        answer, request = _answer(t_s, places, believed, sigma_m, max_wrong)
        tracks.asked(request)
        if alone.found_s is None and isinstance(answer, Fix):
            alone = Outcome(t_s, _off_m(answer, at))
        if by_tracks.found_s is None:
            fix = tracks.answered(answer, ORIGIN, DRIFT_MPS) if isinstance(answer, NoFix) else answer
            if fix is not None:
                by_tracks = Outcome(t_s, _off_m(fix, at))
        if alone.found_s is not None and by_tracks.found_s is not None:
            break
    return alone, by_tracks


def _off_m(fix: Fix, at: FloatArray) -> float:
    north, east, _ = wgs84.ned_from_geo(fix.place, ORIGIN)
    return math.hypot(north - at[0], east - at[1])


def seen_at(
    letters: FloatArray, at: FloatArray, believed: FloatArray, sigma_m: float, missing: bool, rng: np.random.Generator
) -> list[tuple[FloatArray, float]]:
    """Places (2,) that look like what is seen from `at`, within three sigma of where the search is, likeliest first, and their
    probabilities; what they lack of 1 is that of places that are not listed."""
    reach = math.ceil((3 * sigma_m + float(np.linalg.norm(believed - at))) / BLOCK_M)
    steps = [(n, e) for n in range(-reach, reach + 1) for e in range(-reach, reach + 1)]
    likely = []
    for n, e in steps:
        place = at + BLOCK_M * np.array([n, e])
        if np.linalg.norm(place - believed) > 3 * sigma_m or (missing and n == e == 0):
            continue
        unlike = _unlike(letters, at, (n, e))
        likely.append((place + rng.normal(0, PLACE_SIGMA_M, 2), -NATS * unlike + rng.normal(0, NOISE_NATS)))
    if not likely:
        return []
    weights = np.exp([nats for _, nats in likely])
    weights *= weights.max() / (weights.max() + math.exp(-NATS / 3)) / weights.sum()
    order = np.argsort(-weights)[:LISTED]
    return [(likely[k][0], float(weights[k])) for k in order if weights[k] > LEAST]


def _unlike(letters: FloatArray, at: FloatArray, step: tuple[int, int]) -> float:
    """Share of the footprint about a place that is another letter so many squares away."""
    low = (at - FOOTPRINT_M / 2) / BLOCK_M
    first = np.floor(low).astype(int)
    part = low - first
    share = 0.0
    for n, e in ((0, 0), (0, 1), (1, 0), (1, 1)):
        area = (part[0] if n else 1 - part[0]) * (part[1] if e else 1 - part[1])
        here = letters[(first[0] + n) % len(letters), (first[1] + e) % len(letters)]
        there = letters[(first[0] + n + step[0]) % len(letters), (first[1] + e + step[1]) % len(letters)]
        share += area * (here != there)
    return float(share)


def _letters(kind: str, rng: np.random.Generator) -> FloatArray:
    """(40, 40) which kind of square lies where; a stray one is like no other."""
    if kind in ("blocks", "outage", "changed"):
        return rng.integers(0, LETTERS, (40, 40)).astype(np.float64)
    stray = rng.random((40, 40)) < (STRAY if kind == "rows" else 0.0)
    return np.where(stray, 10.0 + np.arange(1600.0).reshape(40, 40), 0.0)


def _prior_share(places: Sequence[tuple[FloatArray, float]], believed: FloatArray, sigma_m: float) -> float:
    """What the prior leaves of the first place's probability, as a factor."""
    prior = [math.exp(-float(np.sum((place - believed) ** 2)) / (2 * sigma_m**2)) for place, _ in places]
    rest = max(0.0, 1 - sum(p for _, p in places))
    whole = sum(g * p for g, (_, p) in zip(prior, places, strict=True)) + 0.2 * rest
    return prior[0] / whole


def _answer(
    t_s: int, places: Sequence[tuple[FloatArray, float]], believed: FloatArray, sigma_m: float, max_wrong: float
) -> tuple[Fix | NoFix, LocaliseRequest]:
    """What the localiser would say, and what it was asked."""
    place = wgs84.geo_from_ned((float(believed[0]), float(believed[1]), -60.0), ORIGIN)
    prior = PosePrior(place, LEVEL, ((sigma_m**2, 0.0), (0.0, sigma_m**2)), 3.0, 0.05, 0.02)
    t_ns, about = t_s * S, (t_s * S, t_s * S, t_s, t_s, "deep")
    request = LocaliseRequest(t_s, FrameRef(t_ns, t_ns, t_s, 0, 320, 240, 3), prior, 1)
    cov = ((0.2, 0.0), (0.0, 0.2))
    opened = tuple(OpenPlace(wgs84.geo_from_ned((float(at[0]), float(at[1]), 0.0), ORIGIN), cov, math.log(p)) for at, p in places)
    wrong = 1 - places[0][1] * _prior_share(places, believed, sigma_m)
    if wrong <= max_wrong:
        return Fix(*about, opened[0].place, LEVEL, cov, 3.0, 0.05, max(wrong, 0.0), 100.0), request
    return NoFix(*about, Reason.AMBIGUOUS, 100.0, open_places=opened, footprint_m=FOOTPRINT_M), request


if __name__ == "__main__":
    main()
