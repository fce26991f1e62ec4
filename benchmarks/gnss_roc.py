"""How soon a false GNSS is declared, how far it had pulled by then, and how often a true one is: by simulated flights.

python -m benchmarks.gnss_roc OUT [--scale 1.0]    (OUT/gnss_roc.json, OUT/gnss_roc.svg; tables on the output)

Training seeds (below 10,000) fit the threshold of the sequential tests to one false alarm in 10 h; all other figures are of
other seeds with the settings that ship. Flights: benchmarks/gnss_runs/gnss_flights.py. No pictures, no filter: the monitor alone.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.gnss_runs.gnss_attacks import ATTACK_SEED, Attack, attacks
from benchmarks.gnss_runs.gnss_flights import FIX_S, PERIOD_S, Flight, Moment, World
from benchmarks.pages.gnss_plot import pulled_svg
from visloc_companion.core.gnss import GnssMonitor
from visloc_companion.core.settings import GnssSettings
from visloc_companion.sim import faults
from visloc_companion.sim.faults import FaultSchedule
from visloc_companion.types import Baro, EkfSource, GeoPoint, Gnss, GnssVerdict, Verdict

SECOND_NS = 1_000_000_000
CLEAN_S, ATTACK_S = 1800.0, 240.0
TRAIN_SEED, SCORE_SEED = 0, 10_000
NEVER = 1e9
MAP_SIGMA_M = 0.5
DEAD_S = 60.0
"""Crossings within this time are one alarm."""
SUITES = {"vision": World(odometry=False), "vision and odometry": World()}


def watch(flight: Flight, settings: GnssSettings, *, grounds: bool = True) -> Iterator[tuple[Moment, GnssMonitor, GnssVerdict]]:
    """The monitor over a flight, with a verdict at every moment; without `grounds` each fix is a witness of its own."""
    monitor = GnssMonitor(settings)
    for m in flight.moments():
        now = round(m.t_s * 1e9) + SECOND_NS
        pressure = 1013.25 * (1 - m.pressure_h_m / 44330.77) ** (1 / 0.190263)
        monitor.on_evidence(Baro(now, now, pressure, 15.0))
        place = GeoPoint(59.0, 18.0, m.h_gnss_m)
        monitor.on_gnss(Gnss(now, now, 3 if m.has_fix else 1, 12, place, 1.0, 1.5, m.v_ned_mps))
        if m.difference_ne_m is not None:
            var, ground = m.over * m.claimed_var_m2, m.ground if grounds else None
            cov_m2 = (var, 0.0), (0.0, var)
            monitor.on_vision(now, m.difference_ne_m, cov_m2, MAP_SIGMA_M, m.v_ned_mps[:2], ground, m.over)
        if m.gnss_moved_ne_m is not None:
            monitor.on_displacement(now - SECOND_NS, now, m.gnss_moved_ne_m, m.odometry_moved_ne_m, m.odometry_var_m2)
        yield m, monitor, monitor.update(now, EkfSource.GNSS)


def log_r(verdict: GnssVerdict) -> tuple[float, float]:
    """The largest statistic of the tests in a verdict's evidence: without odometry, and with it."""
    sums = {name: value for name, value, _ in verdict.evidence if name.endswith("_sum")}
    without = max(sums.get("drift_sum", -math.inf), sums.get("height_sum", -math.inf))
    return without, max(without, sums.get("odometry_sum", -math.inf))


@dataclass(frozen=True, slots=True)
class Series:
    """Second by second while nothing is ever declared: the largest statistic for each of SUITES, and the false distance."""

    log_r: dict[str, np.ndarray]
    false_m: np.ndarray


def statistics_of(flight: Flight, *, grounds: bool = True) -> Series:
    """One flight for both suites: tests that never decide do not touch each other."""
    verdicts = (
        (m, v)
        for k, (m, _, v) in enumerate(watch(flight, GnssSettings(drift_threshold=NEVER), grounds=grounds))
        if k % round(FIX_S / PERIOD_S) == 0
    )
    values = np.array([(*log_r(v), m.false_m) for m, v in verdicts])
    return Series(dict(zip(SUITES, values.T[:2], strict=True)), values[:, 2])


def alarms(series: np.ndarray, threshold: float) -> int:
    """Crossings of a threshold, those within DEAD_S counted once."""
    n, last = 0, -math.inf
    for t in np.nonzero(series > threshold)[0]:
        n += bool(t - last > DEAD_S)
        last = t
    return n


def judged(attack: Attack, seed: int, world: World) -> dict[str, Any]:
    """What became of one flight under attack."""
    flight = Flight(seed, attack.faults, ATTACK_S, world)
    changes, was, before, out_s, pulled, followed, healed_s, back_s = 0, None, 0, None, 0.0, 0, None, None
    for m, monitor, verdict in watch(flight, GnssSettings()):
        changes += was is not None and verdict.verdict is not was
        lost_trust = was is Verdict.OK and verdict.verdict is not Verdict.OK
        was = verdict.verdict
        before += lost_trust and m.t_s < attack.begins_s
        if m.t_s < attack.begins_s:
            continue
        if out_s is None:
            pulled = max(pulled, m.false_m)
            if not monitor.trusted:
                out_s = m.t_s - attack.begins_s
                if not attack.ends:
                    break
        elif monitor.trusted and m.false_m > 5.0:
            followed += 1
        true_now = m.has_fix and m.false_m == 0.0
        back_s = (m.t_s if back_s is None else back_s) if true_now else None
        if out_s is not None and monitor.trusted and true_now and healed_s is None and back_s is not None:
            healed_s = m.t_s - back_s
    return {
        "out_s": out_s,
        "pulled_m": pulled,
        "followed": followed > 0,
        "healed_s": healed_s,
        "before": before,
        "changes": changes,
    }


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Of the flights of one class; those with an alarm before the attack count as declared at once."""
    found = [r for r in rows if r["out_s"] is not None]
    healed = [r["healed_s"] for r in rows if r["healed_s"] is not None]
    return {
        "n": len(rows),
        "declared": len(found),
        "delay_s": quantiles([r["out_s"] for r in found]),
        "pulled_m": quantiles([r["pulled_m"] for r in found]),
        "trusted_while_false": sum(r["followed"] for r in rows),
        "healed": len(healed),
        "healed_s": quantiles(healed),
        "alarms_before": sum(r["before"] for r in rows),
        "changes": max(r["changes"] for r in rows),
    }


def quantiles(values: Sequence[float]) -> list[float] | None:
    """Median, 95th percentile, largest."""
    return [round(float(v), 1) for v in (*np.percentile(values, (50, 95)), max(values))] if values else None


def curve(name: str, clean: Sequence[Series], drags: Sequence[Series], begins_s: float) -> list[dict[str, float]]:
    """False alarms an hour against how far 1 m/s had pulled, over thresholds."""
    hours = sum(len(s.false_m) for s in clean) / 3600
    rows = []
    for threshold in np.arange(5.0, 16.1, 0.5):
        pulled = []
        for s in drags:
            hit = np.nonzero(s.log_r[name][round(begins_s) :] > threshold)[0]
            pulled.append(s.false_m[round(begins_s) + hit[0]] if len(hit) else s.false_m[-1])
        median, p95 = np.percentile(pulled, (50, 95))
        n = sum(alarms(s.log_r[name], threshold) for s in clean)
        rows.append({"threshold": float(threshold), "alarms_per_h": n / hours, "median_m": float(median), "p95_m": float(p95)})
    return rows


def clean_part(scale: float) -> dict[str, dict[str, Any]]:
    """Thresholds fitted on training seeds, false alarms and the curve on others, for both suites."""
    n_train, n_score, n_drag = (max(2, round(n * scale)) for n in (40, 80, 100))
    train = [statistics_of(Flight(TRAIN_SEED + k, FaultSchedule(), CLEAN_S, World())) for k in range(n_train)]
    clean = [statistics_of(Flight(SCORE_SEED + k, FaultSchedule(), CLEAN_S, World())) for k in range(n_score)]
    begins_s, default = 120.0, GnssSettings().drift_threshold
    drags = [
        statistics_of(Flight(SCORE_SEED + 5000 + k, faults.slow_drag(begins_s, 1.0, 0.1 * k), begins_s + 60.0, World()))
        for k in range(n_drag)
    ]
    hours, out = n_train * CLEAN_S / 3600, {}
    for name in SUITES:
        steps = np.arange(5.0, 20.0, 0.25)
        fitted = next(float(t) for t in steps if sum(alarms(s.log_r[name], t) for s in train) <= hours / 10)
        out[name] = {
            "train_hours": hours,
            "fitted_threshold": fitted,
            "clean_hours": n_score * CLEAN_S / 3600,
            "threshold": default,
            "false_alarms": sum(alarms(s.log_r[name], default) for s in clean),
            "false_alarms_at_fitted": sum(alarms(s.log_r[name], fitted) for s in clean),
            "curve": curve(name, clean, drags, begins_s),
        }
    return out


def attacked_part(world: World, scale: float) -> dict[str, Any]:
    """The classes of attack with the settings that ship; with odometry only those in which it matters."""
    classes: dict[str, list[dict[str, Any]]] = {}
    for k, attack in enumerate(attacks(scale)):
        if attack.ends and world.odometry:
            continue
        classes.setdefault(attack.name, []).append(judged(attack, ATTACK_SEED + k, world))
    return {"classes": {name: summary(rows) for name, rows in classes.items()}, "flights": sum(map(len, classes.values()))}


def shown(result: dict[str, Any]) -> str:
    """The tables, as they stand in docs/benchmarks/navigation.md."""
    lines = [
        f"threshold {result['threshold']:g} (fitted on {result['train_hours']:g} h: {result['fitted_threshold']:g}), "
        f"{result['false_alarms']} false alarms in {result['clean_hours']:g} h, "
        f"at the fitted one {result['false_alarms_at_fitted']}",
        "",
        "| attack | n | declared | after s: median, 95 %, worst | pulled m: median, 95 %, worst | trusted while false "
        "| true again: trusted | after s | changes |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, row in result["classes"].items():
        cells = (
            name,
            row["n"],
            row["declared"],
            listed(row["delay_s"]),
            listed(row["pulled_m"]),
            row["trusted_while_false"],
            row["healed"],
        )
        lines.append("| " + " | ".join(map(str, cells)) + f" | {listed(row['healed_s'])} | {row['changes']} |")
    return "\n".join(lines)


def listed(values: Sequence[float] | None) -> str:
    return "" if values is None else ", ".join(f"{v:.1f}" for v in values)


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--scale", type=float, default=1.0, help="share of the flights (for a quick look)")
    args = parser.parse_args(argv)
    begun = time.process_time()
    results: dict[str, dict[str, Any]] = clean_part(args.scale)
    for name, world in SUITES.items():
        results[name] |= attacked_part(world, args.scale)
        print(f"\n### {name}\n\n{shown(results[name])}", flush=True)
    args.out.mkdir(parents=True, exist_ok=True)
    results["seconds"] = {"cpu": round(time.process_time() - begun, 1)}
    (args.out / "gnss_roc.json").write_text(json.dumps(results, indent=1), encoding="utf-8")
    (args.out / "gnss_roc.svg").write_text(pulled_svg({n: results[n]["curve"] for n in SUITES}), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
