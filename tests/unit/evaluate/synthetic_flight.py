"""A made-up flight for tests of figures and reports: a square circuit, GNSS dragged from 60 s and jammed from 120 s."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from visloc_companion.app.journal import Entry
from visloc_companion.errors import Reason
from visloc_companion.evaluate.record import FlightRecord, from_entries
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.types import (
    Fix,
    FrameRef,
    GeoPoint,
    Gnss,
    Injection,
    LocaliseRequest,
    Mode,
    NoFix,
    PosePrior,
    Status,
    Verdict,
)

HOME = GeoPoint(47.4, 8.55, 488.0)
LEVEL = (1.0, 0.0, 0.0, 0.0)
T0_NS = 5_000_000_000


@dataclass(frozen=True)
class Truth:
    t_ns: int
    place: GeoPoint


def ns(t_s: float) -> int:
    return T0_NS + round(t_s * 1e9)


def true_ned(t_s: float, side_m: float = 300.0, speed_mps: float = 10.0) -> tuple[float, float, float]:
    along = (t_s * speed_mps) % (4 * side_m)
    leg, s = int(along // side_m), along % side_m
    corners = ((0, 0), (side_m, 0), (side_m, side_m), (0, side_m))
    (n0, e0), (n1, e1) = corners[leg], corners[(leg + 1) % 4]
    return n0 + (n1 - n0) * s / side_m, e0 + (e1 - e0) * s / side_m, -100.0


def place(ned: tuple[float, float, float]) -> GeoPoint:
    return geo_from_ned(ned, HOME)


def make_entries(duration_s: float = 200.0, seed: int = 1) -> list[Entry]:
    rng = np.random.default_rng(seed)
    entries: list[Entry] = []
    error = np.zeros(2)
    for k in range(round(duration_s * 10)):
        t = k / 10
        n, e, d = true_ned(t)
        error = 0.97 * error + rng.normal(0, 0.25, 2)
        denied, suspect = t >= 120, 85 <= t < 120
        verdict = Verdict.DENIED if denied else Verdict.SUSPECT if suspect else Verdict.OK
        mode = Mode.AIDING if t >= 85 else Mode.SHADOW if t > 4 else Mode.WAITING
        if 150 <= t < 156:
            mode = Mode.DEAD_RECKONING
        sigma = 0.9 + (0.5 * (t - 150) if 150 <= t < 156 else 0.0)
        if k % 2 == 0 and not denied:
            drag = 1.5 * max(0.0, t - 60)
            entries.append(Entry(ns(t), Gnss(ns(t), ns(t), 3, 14, place((n + drag, e + 0.4 * drag, d)), 1.0, 1.5, None), None))
        if k % 2 == 1 and t > 4:
            entries += frame_entries(t, (n, e, d), k, rng)
        estimate = None if mode is Mode.WAITING else place((n + error[0], e + error[1], d))
        cov = ((sigma**2, 0.1), (0.1, sigma**2))
        injected = mode in (Mode.AIDING, Mode.DEAD_RECKONING)
        reasons = ("no fix",) if denied else ("disagrees with vision",) if suspect else ()
        level = None if estimate is None else 4.5 * sigma
        above = None if estimate is None else replace(estimate, h_amsl_m=estimate.h_amsl_m + 2.5 + math.sin(t / 30))
        high = None if estimate is None else 9.0 + math.sin(t / 9)
        limits = (high, -2.5, 25.0, 50.0)
        status = Status(ns(t), mode, verdict, reasons, above, (0, 0, 0), cov, 1.0, level, 0.3, injected, 0, *limits)
        if injected and estimate is not None:
            entries.append(Entry(ns(t), None, Injection(ns(t), (n, e, d), estimate, LEVEL, cov, 1.0, 0.05, 0)))
        entries.append(Entry(ns(t), None, status))
    return entries


def frame_entries(t: float, ned: tuple[float, float, float], k: int, rng: np.random.Generator) -> list[Entry]:
    frame = FrameRef(ns(t), ns(t), k, 0, 640, 480, 3)
    cov = ((1.0, 0.0), (0.0, 1.0))
    request = LocaliseRequest(k, frame, PosePrior(place(ned), LEVEL, cov, 1, 0.1, 0.1), 1)
    took_ms = float(rng.gamma(9, 14)) + 30
    arrival = ns(t) + round(took_ms * 1e6)
    answer: Fix | NoFix
    if 150 <= t < 156 or rng.random() < 0.04:
        reason = Reason.AMBIGUOUS if rng.random() < 0.6 else Reason.NO_MATCH
        answer = NoFix(arrival, ns(t), k, k, "gradient", reason, took_ms - 20)
    else:
        where = place((ned[0] + rng.normal(0, 0.8), ned[1] + rng.normal(0, 0.8), ned[2]))
        answer = Fix(arrival, ns(t), k, k, "gradient", where, LEVEL, cov, 1.0, 0.02, 1e-4, took_ms - 20)
    return [Entry(ns(t), frame, None), Entry(ns(t), None, request), Entry(arrival, answer, None)]


def make_truth(duration_s: float = 200.0) -> list[Truth]:
    return [Truth(ns(k / 10), place(true_ned(k / 10))) for k in range(round(duration_s * 10))]


def make_record(duration_s: float = 200.0) -> FlightRecord:
    return from_entries(make_entries(duration_s), make_truth(duration_s), t0_ns=T0_NS)


def make_baseline(duration_s: float = 200.0) -> FlightRecord:
    """The flight without the daemon: it follows the false GNSS away, then lands."""
    truth = []
    for k in range(round(duration_s * 10)):
        t = k / 10
        drag = 1.5 * max(0.0, min(t, 124.0) - 60)
        n, e, d = true_ned(min(t, 124.0))
        drift = 2.5 * max(0.0, t - 124.0)
        truth.append(Truth(ns(t), place((n - drag - drift, e - 0.4 * drag + 0.5 * drift * math.sin(t / 30), d))))
    return from_entries([], truth, t0_ns=T0_NS)
