"""What a scenario expects, each against what the flight showed; limits on errors grow with pixels coarser than one metre."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from visloc_companion.evaluate.gate import Check
from visloc_companion.evaluate.metrics import count_hmi, error_figures
from visloc_companion.evaluate.record import NS_PER_S, FixPoint, FlightRecord
from visloc_companion.localise.structure.localiser import METHOD as STRUCTURE
from visloc_companion.sim.flight import FlightLog
from visloc_companion.sim.scenarios import Expectation, Scenario
from visloc_companion.types import Mode, Status, Verdict

ALERT_LIMIT_M = 25.0
TICKS_AT_THE_END = 10
UNSEEN_PX = 3.0
"""A drag at 1 m/s needs so many seconds per metre of pixel size before it leaves the map's own error."""
SAME_TIME_S = 1e-3
MOST_SIGMA = 3.0


def checks_of(scenario: Scenario, log: FlightLog, record: FlightRecord, summary: dict[str, Any], gsd_m: float) -> list[Check]:
    """All that is expected of a flight. What only the log knows (which fixes were taken) is left out where it is empty."""
    expected, start_s, coarse = scenario.expected, scenario.fault_start_s, max(1.0, gsd_m)
    relied_on = relied_upon(record, start_s)
    gap_ms = summary["injected"]["gap_max_ms"]
    checks = [
        *_errors(expected, record, relied_on, coarse),
        *_verdict(expected, summary["gnss"]["detected_at_s"], start_s, coarse),
        _at_most("pulled by false GNSS", log.pulled_m, expected.pulled_m * coarse, "m"),
        _at_most("longest gap between injections", gap_ms, 1e3 * expected.injection_gap_s, "ms"),
        _at_most("false alarms", summary["gnss"]["false_alarms"], 0, ""),
        _at_most("hazardously misleading epochs", count_hmi(record, ALERT_LIMIT_M), 0, ""),
        _at_most("error beyond protection level for", longest_misled_s(record, relied_on), 0.0, "s"),
        _failsafe(expected, log, record),
        _at_the_end("verdict at the end", record.verdicts, expected.final_verdicts),
        _gone_through(record, start_s, expected.modes),
        _at_the_end("mode at the end", record.modes, expected.final_modes),
    ]
    if log.entries:
        wrong_m = max((error for fix, error in taken_fixes(log, record) if fix.t_s >= start_s), default=0.0)
        checks.append(_at_most("furthest fix that was taken", wrong_m, expected.wrong_fix_m * coarse, "m"))
        jump = largest_jump(log, record, start_s)
        checks.append(_at_most("largest step without a reset", 0.0 if jump is None else jump, MOST_SIGMA, "sigma"))
    if expected.structure_share > 0:
        checks.append(_carried_by_structure(record, start_s, expected.structure_share))
    return checks


def relied_upon(record: FlightRecord, start_s: float) -> NDArray[np.bool_]:
    """(N,) epochs without GNSS whose position went to the autopilot."""
    return np.asarray((record.t_s >= start_s) & record.injected, dtype=np.bool_)


def error_over_level(record: FlightRecord, epochs: NDArray[np.bool_]) -> float | None:
    """The largest ratio of horizontal error to protection level among epochs (N,), None where nothing is known of any."""
    error, level = record.error_m[epochs], record.protection_level_m[epochs]
    known = np.isfinite(error) & (level > 0)
    return round(float(np.max(error[known] / level[known])), 4) if known.any() else None


def longest_misled_s(record: FlightRecord, epochs: NDArray[np.bool_]) -> float:
    """For how long the error exceeded the protection level at a stretch, of epochs (N,); one epoch alone counts as the time to
    the next, the last of a flight as long as the one before."""
    misled, times_s = epochs & (record.error_m > record.protection_level_m), record.t_s.tolist()
    longest, began_s = 0.0, None
    for k, next_s in enumerate([*times_s[1:], 2 * times_s[-1] - times_s[-2]] if len(times_s) > 1 else []):
        began_s = (times_s[k] if began_s is None else began_s) if misled[k] else None
        if began_s is not None:
            longest = max(longest, next_s - began_s)
    return longest


def taken_fixes(log: FlightLog, record: FlightRecord) -> list[tuple[FixPoint, float]]:
    """The fixes that the navigator fused, with their horizontal errors in metres: those that a status names as its last."""
    statuses = [entry.command for entry in log.entries if isinstance(entry.command, Status)]
    last_s = {
        (status.t_ns - record.t0_ns) / NS_PER_S - status.age_of_fix_s for status in statuses if status.age_of_fix_s is not None
    }
    times = np.array(sorted(last_s), dtype=np.float64)
    found: list[tuple[FixPoint, float]] = []
    for fix in record.fixes:
        if len(times) and np.min(np.abs(times - fix.t_s)) < SAME_TIME_S:
            truth = record.truth.at(np.array([fix.t_s]))[0]
            found.append((fix, float(np.hypot(fix.p_ned_m[0] - truth[0], fix.p_ned_m[1] - truth[1]))))
    return found


def largest_jump(log: FlightLog, record: FlightRecord, start_s: float) -> float | None:
    """The largest step between successive injected positions less the motion between them, in sigmas of the first.

    Steps that a new reset counter announces are left out, and those across a pause.
    """
    statuses = [entry.command for entry in log.entries if isinstance(entry.command, Status)]
    places = record.estimate_ned_m[:, :2]
    worst: float | None = None
    for k in range(1, min(len(statuses), len(places))):
        before, after = statuses[k - 1], statuses[k]
        dt_s = (after.t_ns - before.t_ns) / NS_PER_S
        counted = before.injected and after.injected and before.reset_counter == after.reset_counter and record.t_s[k] >= start_s
        if not counted or not 0 < dt_s < 0.5:
            continue
        v = (np.array(before.v_ned_mps[:2]) + np.array(after.v_ned_mps[:2])) / 2
        step = float(np.linalg.norm(places[k] - places[k - 1] - v * dt_s)) / float(record.sigma_m[k - 1])
        worst = step if worst is None else max(worst, step)
    return worst


def _errors(expected: Expectation, record: FlightRecord, relied_on: NDArray[np.bool_], coarse: float) -> list[Check]:
    unaided = np.array(record.modes, dtype=str) == Mode.DEAD_RECKONING
    apart = expected.dead_reckoning_m is not None
    error = error_figures(record, relied_on & ~unaided if apart else relied_on)
    limits = [
        ("median error without GNSS", expected.median_error_m, error["median"]),
        ("largest error without GNSS", expected.max_error_m, error["max"]),
    ]
    if apart:
        drift = error_figures(record, relied_on & unaided)
        limits.append(("largest error without fixes", expected.dead_reckoning_m, drift["max"]))
        limits = [limit for limit in limits if limit[2] is not None]  # not every flight has epochs of both kinds
    return [_at_most(name, value, limit * coarse, "m") for name, limit, value in limits if limit is not None]


def _verdict(expected: Expectation, detected_s: float | None, start_s: float, coarse: float) -> list[Check]:
    if expected.verdict_within_s is None:
        return []
    delay = None if detected_s is None else detected_s - start_s
    return [_at_most("GNSS declared bad after", delay, expected.verdict_within_s + UNSEEN_PX * (coarse - 1.0), "s", "never")]


def _failsafe(expected: Expectation, log: FlightLog, record: FlightRecord) -> Check:
    """None; or, where nothing can be recognised, only after the daemon has said that it is lost."""
    said = expected.failsafe and Mode.LOST in record.modes
    return Check(
        "failsafe", log.failsafe or "none", "none, or after LOST" if expected.failsafe else "none", log.failsafe is None or said
    )


def _at_most(name: str, value: float | None, limit: float, unit: str, missing: str = "none known") -> Check:
    shown = missing if value is None else f"{value:.3g} {unit}".strip()
    return Check(name, shown, f"≤ {limit:.3g} {unit}".strip(), value is not None and value <= limit)


def _at_the_end(name: str, named: tuple[str, ...], allowed: tuple[Verdict, ...] | tuple[Mode, ...]) -> Check:
    seen = set(named[-TICKS_AT_THE_END:])
    return Check(name, ", ".join(sorted(seen)) or "none", " or ".join(allowed), bool(seen) and seen <= set(allowed))


def _gone_through(record: FlightRecord, start_s: float, wanted: tuple[Mode, ...]) -> Check:
    later = [mode for t_s, mode in zip(record.t_s, record.modes, strict=True) if t_s >= start_s]
    seen = [mode for k, mode in enumerate(later) if k == 0 or mode != later[k - 1]]
    ahead = iter(seen)
    passed = all(mode in ahead for mode in wanted)
    return Check("modes without GNSS", ", ".join(seen[:12]) or "none", "through " + ", ".join(wanted), passed)


def _carried_by_structure(record: FlightRecord, start_s: float, least: float) -> Check:
    methods = [fix.method for fix in record.fixes if fix.t_s >= start_s]
    share = methods.count(STRUCTURE) / len(methods) if methods else 0.0
    shown = f"{share:.0%} of {len(methods)}"
    return Check("fixes by structure without GNSS", shown, f"≥ {least:.0%}", share >= least)
