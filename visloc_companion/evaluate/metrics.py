"""The figures of a flight (docs/replay.md, Figures), and its epochs as CSV. Undefined figures are None, never NaN."""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from visloc_companion.evaluate import stanford
from visloc_companion.evaluate.record import FixPoint, FlightRecord, Refusal
from visloc_companion.types import FloatArray, Mode, Verdict
from visloc_companion.whole_file import write_result

SCHEMA = 1
DEFAULT_ALERT_LIMIT_M = 25.0
GNSS_HEALTHY_M = 10.0
"""A receiver that is closer to the truth than this is healthy: a verdict against it is a false alarm."""
_TRUSTED_WITHIN_S = 10.0
"""A healthy receiver is called OK some two seconds after its first position; one that never is was called bad wrongly."""
_NOT_INJECTING = (Mode.WAITING, Mode.SHADOW)
Interval = tuple[float, float]


def flight_summary(
    record: FlightRecord,
    *,
    alert_limit_m: float = DEFAULT_ALERT_LIMIT_M,
    gnss_faults_s: Sequence[Interval] | None = None,
    latency: Literal["arrival", "computation"] = "arrival",
    epochs: str | None = None,
) -> dict[str, Any]:
    """The JSON of a flight. Only finite numbers; None where a figure is undefined (no truth, no fixes, no injections).

    `gnss_faults_s` are the intervals (s since the start) in which GNSS was really bad, where the scenario knows them; without
    them a verdict counts as false where the receiver was near the truth (`false_alarms`). `latency` chooses what is stated: from
    exposure to the answer's arrival, or the computation alone (a replay's own). `epochs` names the CSV file beside the JSON.
    """
    reasons = Counter(refusal.reason for refusal in record.refusals)
    return {
        "schema": SCHEMA,
        "duration_s": round(record.duration_s, 3),
        "n_frames": record.n_frames,
        "n_fixes": len(record.fixes),
        "n_no_fix": len(record.refusals),
        "reasons": dict(sorted(reasons.items())),
        "error_horizontal_m": error_figures(record),
        "availability": availability(record, alert_limit_m),
        "hmi": count_hmi(record, alert_limit_m),
        "misleading": count_misleading(record),
        "integrity": {
            "horizontal": stanford.horizontal(record, alert_limit_m).summary(),
            "vertical": stanford.vertical(record).summary(),
        },
        "nees": mean_nees(record),
        "gnss": {
            "detected_at_s": detected_at_s(record, gnss_faults_s),
            "false_alarms": false_alarms(record, gnss_faults_s),
        },
        "injected": injection_figures(record),
        "latency_ms": latency_figures(record, latency),
        "epochs": epochs,
    }


def error_figures(record: FlightRecord, epochs: NDArray[np.bool_] | None = None) -> dict[str, float | None]:
    """Mean, median, 95th percentile and maximum of the horizontal error (m), over all epochs or those of a (N,) mask."""
    error = record.error_m if epochs is None else record.error_m[epochs]
    error = error[np.isfinite(error)]
    if not len(error):
        return {"mean": None, "median": None, "p95": None, "max": None}
    return {
        "mean": _rounded(np.mean(error)),
        "median": _rounded(np.median(error)),
        "p95": _rounded(np.percentile(error, 95)),
        "max": _rounded(np.max(error)),
    }


def fix_errors_m(record: FlightRecord) -> FloatArray:
    """(K,) horizontal distance of each fix from the truth at its exposure, NaN where that is unknown."""
    found = np.array([fix.p_ned_m[:2] for fix in record.fixes], dtype=np.float64).reshape(-1, 2)
    truth = record.truth.at(np.array([fix.t_s for fix in record.fixes], dtype=np.float64))
    return np.asarray(np.hypot(*(found - truth[:, :2]).T), dtype=np.float64)


def availability(record: FlightRecord, alert_limit_m: float) -> float | None:
    """Share of the epochs since the first estimate whose protection level is stated and within the alert limit.

    0 for a flight that never had an estimate, None for one without epochs.
    """
    if not len(record.t_s):
        return None
    known = np.isfinite(record.estimate_ned_m[:, 0])
    if not known.any():
        return 0.0
    within = known & (record.protection_level_m <= alert_limit_m)
    return _rounded(np.mean(within[int(np.argmax(known)) :]))


def count_hmi(record: FlightRecord, alert_limit_m: float) -> int | None:
    """Epochs whose error exceeds the alert limit while the protection level does not. None without truth."""
    error = record.error_m
    if not np.isfinite(error).any():
        return None
    return int(np.sum((error > alert_limit_m) & (record.protection_level_m <= alert_limit_m)))


def judged_epochs(record: FlightRecord) -> int:
    """How many epochs `count_hmi` and `count_misleading` can judge: those with an error and a protection level."""
    return int(np.sum(np.isfinite(record.error_m) & np.isfinite(record.protection_level_m)))


def count_misleading(record: FlightRecord) -> int | None:
    """Epochs whose error exceeds the stated protection level, whatever the alert limit. None without truth."""
    error = record.error_m
    return int(np.sum(error > record.protection_level_m)) if np.isfinite(error).any() else None


def nees(record: FlightRecord) -> FloatArray:
    """(M,) normalised estimation error squared of the epochs with truth: 2 on average where the covariance is right."""
    error, cov = record.error_ne_m, record.cov_ne_m2
    usable = np.asarray(np.isfinite(error).all(axis=1) & (np.linalg.det(cov) > 1e-12), dtype=bool)
    if not usable.any():
        return np.zeros(0)
    solved = np.linalg.solve(cov[usable], error[usable][..., None])[..., 0]
    return np.asarray(np.sum(error[usable] * solved, axis=1), dtype=np.float64)


def mean_nees(record: FlightRecord) -> float | None:
    """Mean NEES (2 degrees of freedom), None without truth."""
    values = nees(record)
    return _rounded(np.mean(values)) if len(values) else None


def alarms_s(record: FlightRecord) -> list[float]:
    """Times at which the verdict leaves OK. A flight that begins without OK has its first alarm once OK has been lost."""
    found: list[float] = []
    was_ok = False
    for t_s, verdict in record.changes(record.verdicts):
        if verdict == Verdict.OK:
            was_ok = True
        elif was_ok:
            found.append(t_s)
            was_ok = False
    return found


def detected_at_s(record: FlightRecord, gnss_faults_s: Sequence[Interval] | None = None) -> float | None:
    """When GNSS was first declared bad, seconds since the start; at or after the first fault where faults are known."""
    not_before = min((start for start, _ in gnss_faults_s), default=math.inf) if gnss_faults_s is not None else -math.inf
    seen = [t_s for t_s in alarms_s(record) if t_s >= not_before]
    if not seen and Verdict.OK not in record.verdicts:
        seen = [t_s for t_s, _ in record.changes(record.verdicts)[:1]]
    return _rounded(seen[0]) if seen else None


def false_alarms(record: FlightRecord, gnss_faults_s: Sequence[Interval] | None = None) -> int | None:
    """How often GNSS was called bad while it was healthy: the verdict left OK then, or it never was OK although GNSS was healthy
    for ten seconds at a stretch, which counts once. None where nobody knows whether it was, be it at one of the alarms."""
    if gnss_faults_s is None and not len(record.truth.t_s):
        return None
    if Verdict.OK not in record.verdicts:
        healthy = _gnss_healthy(record, record.t_s, gnss_faults_s) == 1.0
        return int(_longest_s(record.t_s, healthy) >= _TRUSTED_WITHIN_S)
    healthy_then = _gnss_healthy(record, np.array(alarms_s(record), dtype=np.float64), gnss_faults_s)
    return None if np.isnan(healthy_then).any() else int(np.sum(healthy_then))


def _gnss_healthy(record: FlightRecord, t_s: FloatArray, gnss_faults_s: Sequence[Interval] | None) -> FloatArray:
    """(N,) 1 at times at which GNSS was healthy, 0 where it was not or had no position, NaN where the truth is not known."""
    if gnss_faults_s is not None:
        return np.array([not any(start <= at_s <= end for start, end in gnss_faults_s) for at_s in t_s], dtype=np.float64)
    truth_ne_m = record.truth.at(t_s)[:, :2]
    near = np.hypot(*(record.gnss.at(t_s)[:, :2] - truth_ne_m).T) < GNSS_HEALTHY_M
    return np.where(np.isnan(truth_ne_m[:, 0]), np.nan, near.astype(np.float64))


def _longest_s(t_s: FloatArray, here: NDArray[np.bool_]) -> float:
    """The longest stretch of times (N,), seconds, at which a mask (N,) holds."""
    longest, began_s = 0.0, None
    for at_s, holds in zip(t_s.tolist(), here.tolist(), strict=True):
        began_s = (at_s if began_s is None else began_s) if holds else None
        longest = longest if began_s is None else max(longest, at_s - began_s)
    return longest


def injection_figures(record: FlightRecord) -> dict[str, float | int | None]:
    """Number, rate (Hz, while injecting) and longest gap (ms) of the injections.

    A pause in which the navigator was WAITING or in SHADOW was meant and is no gap.
    """
    times = record.injection_t_s
    gaps = np.diff(times)
    kept = gaps[~_paused(record, times)] if len(gaps) else gaps
    total = float(np.sum(kept))
    return {
        "n": len(times),
        "rate_hz": _rounded(len(kept) / total) if total > 0 else None,
        "gap_max_ms": _rounded(np.max(kept) * 1e3) if len(kept) else None,
    }


def _paused(record: FlightRecord, times: FloatArray) -> NDArray[np.bool_]:
    idle = np.isin(np.array(record.modes, dtype=str), [str(mode) for mode in _NOT_INJECTING])
    idle_t_s = record.t_s[idle] if len(record.modes) else np.zeros(0)
    return np.asarray(np.searchsorted(idle_t_s, times[1:]) > np.searchsorted(idle_t_s, times[:-1], side="right"))


def latency_figures(record: FlightRecord, which: Literal["arrival", "computation"] = "arrival") -> dict[str, float | None]:
    """Percentiles of the time (ms) that answers took, fixes and refusals together."""
    answers: list[FixPoint | Refusal] = [*record.fixes, *record.refusals]
    values = [latency_ms(answer, which) for answer in answers]
    finite = [value for value in values if math.isfinite(value)]
    return {f"p{q}": _rounded(np.percentile(finite, q)) if finite else None for q in (50, 95, 99)}


def latency_ms(answer: FixPoint | Refusal, which: Literal["arrival", "computation"]) -> float:
    """What an answer took: from exposure to its arrival, or the computation alone."""
    return answer.latency_ms if which == "arrival" else answer.elapsed_ms


EPOCH_COLUMNS = (
    *("t_s", "mode", "verdict", "reasons", "estimate_n_m", "estimate_e_m", "estimate_d_m", "truth_n_m", "truth_e_m", "truth_d_m"),
    *("error_m", "sigma_m", "protection_level_m", "vertical_error_m", "vertical_protection_level_m", "injected"),
)


def write_epochs(record: FlightRecord, path: Path) -> None:
    """One CSV row a tick; positions NED about the record's origin, empty where unknown."""
    held = [record.error_m, record.sigma_m, record.protection_level_m]
    vertical = [record.vertical_error_m, record.vertical_protection_level_m]
    numbers = np.column_stack([record.estimate_ned_m, record.truth_ned_m, *held, *vertical])
    file = io.StringIO(newline="")
    writer = csv.writer(file)
    writer.writerow(EPOCH_COLUMNS)
    for i, t_s in enumerate(record.t_s):
        values = [f"{value:.3f}" if math.isfinite(value) else "" for value in numbers[i]]
        names = (record.modes[i], record.verdicts[i], " ".join(record.reasons[i]))
        writer.writerow([f"{t_s:.3f}", *names, *values, int(record.injected[i])])
    write_result(path, file.getvalue().encode())


def _rounded(value: Any) -> float:
    return round(float(value), 4)
