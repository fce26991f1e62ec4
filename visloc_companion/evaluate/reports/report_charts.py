"""The charts of a flight over time, on one time axis: errors against what was claimed, verdict, mode, injections and fixes."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from visloc_companion.evaluate.record import FixPoint, FlightRecord, Refusal
from visloc_companion.evaluate.reports.report_svg import (
    Scale,
    circle,
    decades,
    figure,
    legend,
    line,
    number,
    path,
    rect,
    text,
    thinned,
    ticks,
    x_axis,
    y_axis,
)
from visloc_companion.types import FloatArray, Verdict

WIDTH, _LEFT, _RIGHT = 1200.0, 118.0, 1182.0
_PLOT_TOP, _PLOT_BOTTOM = 12.0, 340.0
_STRIP, _STRIP_GAP = 24.0, 9.0
_FLOOR_M = 0.1
_RADIUS = {"dotfix": 2.2, "dotring": 3.2}
_WORDS = {"dead_reckoning": "dead reckoning", "ok": "OK", "suspect": "SUSPECT", "denied": "DENIED", "on": "injecting", "off": ""}


def time_chart(record: FlightRecord, alert_limit_m: float | None, strayed: tuple[FloatArray, FloatArray] | None) -> str:
    """Errors (log scale) over the strips of verdict, mode, injections and fixes, one time axis under all.

    `strayed` is (t_s, metres): how far the flight without the daemon was from this one at each time.
    """
    t = Scale(0.0, max(record.duration_s, 1.0), _LEFT, _RIGHT)
    curves = _curves(record, strayed)
    fixes = [(css, *_fix_errors(record, method)) for method, css in _dots(record)]
    shown = [values for _, values, _ in curves] + [error_m for _, _, error_m in fixes]
    top = max([20.0, alert_limit_m or 0.0, *(float(np.nanmax(v)) for v in shown if np.isfinite(v).any())])
    metres = Scale(
        _FLOOR_M, 10 ** math.ceil(math.log10(top) * 2) if top > 1e5 else _round_up(top), _PLOT_BOTTOM, _PLOT_TOP, log=True
    )
    bottom = _PLOT_BOTTOM + 14 + (3 + max(1, len(_methods(record)))) * (_STRIP + _STRIP_GAP)
    parts = [*_bands(record, t), *y_axis(metres, _LEFT, _RIGHT, "metres (log scale)", decades(metres.low, metres.high))]
    parts += x_axis(t, _PLOT_TOP, bottom, "time since the start (s)")
    if alert_limit_m is not None:
        parts.append(line(_LEFT, metres(alert_limit_m), _RIGHT, metres(alert_limit_m), "limit"))
    for css, fix_t_s, fix_error_m in fixes:
        dots = zip(*thinned(fix_t_s, fix_error_m), strict=True)
        parts += [circle(t(x), metres(y), _RADIUS[css], css) for x, y in dots if math.isfinite(y)]
    for times, values, css in curves:
        few_t, few = thinned(times, values)
        parts.append(path(t.many(few_t), metres.many(few), css))
    parts += _strips(record, t)
    return figure(WIDTH, bottom + 48, parts, "Errors, verdict, mode, injections and fixes over time", "wide")


def time_legend(record: FlightRecord, alert_limit_m: float | None, strayed: bool) -> str:
    """What the lines of `time_chart` are; only those that are there."""
    items: list[tuple[str, str]] = []
    if np.isfinite(record.error_m).any():
        items.append(("error", "horizontal error of our estimate"))
    if record.fixes and len(record.truth.t_s):
        named = len(_methods(record)) > 1
        items += [
            (css, f"error of single fixes by {method}" if named else "error of single fixes") for method, css in _dots(record)
        ]
    if np.isfinite(record.sigma_m).any():
        items.append(("sigma", "claimed 1-sigma (larger axis)"))
    if np.isfinite(record.protection_level_m).any():
        items.append(("level", "protection level"))
    if alert_limit_m is not None:
        items.append(("limit", f"alert limit {number(alert_limit_m)} m"))
    if strayed:
        items.append(("baseline", "flight without the daemon: how far from this one"))
    for verdict in (Verdict.SUSPECT, Verdict.DENIED):
        if verdict in record.verdicts:
            items.append((f"band-{verdict}", f"GNSS {_WORDS[verdict]}"))
    return legend(items)


def _curves(record: FlightRecord, strayed: tuple[FloatArray, FloatArray] | None) -> list[tuple[FloatArray, FloatArray, str]]:
    curves = [
        (record.t_s, record.protection_level_m, "level"),
        (record.t_s, record.sigma_m, "sigma"),
        (record.t_s, record.error_m, "error"),
    ]
    return [(*strayed, "baseline"), *curves] if strayed is not None else curves


def _methods(record: FlightRecord) -> tuple[str, ...]:
    """Names of the localisers that answered, the one with the most answers first."""
    answers: list[FixPoint | Refusal] = [*record.fixes, *record.refusals]
    return tuple(name for name, _ in Counter(answer.method for answer in answers).most_common())


def _dots(record: FlightRecord) -> list[tuple[str, str]]:
    """(method, class of its dots): discs for the one that answered most, rings for any other."""
    return [(method, "dotring" if rank else "dotfix") for rank, method in enumerate(_methods(record))]


def _fix_errors(record: FlightRecord, method: str) -> tuple[FloatArray, FloatArray]:
    fixes = [fix for fix in record.fixes if fix.method == method]
    t_s = np.array([fix.t_s for fix in fixes], dtype=np.float64)
    p = np.array([fix.p_ned_m for fix in fixes], dtype=np.float64).reshape(-1, 3)
    apart = p[:, :2] - record.truth.at(t_s)[:, :2]
    return t_s, np.asarray(np.hypot(*apart.T), dtype=np.float64)


def _round_up(value: float) -> float:
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= value)


def spans(record: FlightRecord, names: Sequence[str]) -> list[tuple[float, float, str]]:
    """(from_s, to_s, name) of a per-epoch name; the last one lasts to the flight's last epoch."""
    changes = record.changes(names)
    end = float(record.t_s[-1]) if len(record.t_s) else 0.0
    return [(start, stop, name) for (start, name), (stop, _) in pairwise([*changes, (end, "")])]


def _bands(record: FlightRecord, t: Scale) -> list[str]:
    bad = [span for span in spans(record, record.verdicts) if span[2] != Verdict.OK]
    return [
        rect(t(start), _PLOT_TOP, t(stop) - t(start), _PLOT_BOTTOM - _PLOT_TOP, f"band-{name}", f"GNSS {name}")
        for start, stop, name in bad
    ]


def _strips(record: FlightRecord, t: Scale) -> list[str]:
    injecting = ["on" if injected else "off" for injected in record.injected]
    rows = (("GNSS verdict", record.verdicts), ("mode", record.modes), ("injecting", injecting))
    parts: list[str] = []
    y = _PLOT_BOTTOM + 14
    for title, names in rows:
        parts.append(text(_LEFT - 10, y + 17, title, "strip", "end"))
        for start, stop, name in spans(record, names):
            width = t(stop) - t(start)
            parts.append(rect(t(start), y, width, _STRIP, f"s-{name}", f"{title}: {name}, {start:.1f} s to {stop:.1f} s"))
            words = _WORDS.get(name, name)
            if title != "injecting" and words and width > 8.5 * len(words):
                parts.append(text(t(start) + width / 2, y + 17, words, "strip"))
        y += _STRIP + _STRIP_GAP
    for method in _methods(record) or ("",):
        parts += _fix_strip(record, method, t, y)
        y += _STRIP + _STRIP_GAP
    return parts


def _fix_strip(record: FlightRecord, method: str, t: Scale, y: float) -> list[str]:
    title = method if len(_methods(record)) > 1 else "fix / none"
    parts = [
        text(_LEFT - 10, y + 17, title, "strip", "end"),
        rect(_LEFT, y, _RIGHT - _LEFT, _STRIP, "s-off", f"{title}: fix, none"),
    ]
    for times, top, css in (
        ([fix.t_s for fix in record.fixes if fix.method == method], y, "mark"),
        ([refusal.t_s for refusal in record.refusals if refusal.method == method], y + _STRIP / 2, "markno"),
    ):
        columns = sorted({round(t(x)) for x in times if t.low <= x <= t.high})
        parts += [rect(x - 0.5, top, 1.2, _STRIP / 2, css) for x in columns]
    return parts


_H_WIDTH, _H_HEIGHT, _H_LEFT, _H_BOTTOM, _H_TOP = 600.0, 340.0, 74.0, 280.0, 50.0


def latency_histogram(values_ms: FloatArray, words: str) -> str:
    """How long answers took: counts over milliseconds, median and 95th percentile marked. Values must be finite."""
    high = _round_up(max(float(np.percentile(values_ms, 99.5)) * 1.1, 1.0))
    counts, edges = np.histogram(np.clip(values_ms, 0, high), bins=40, range=(0, high))
    x, y = Scale(0, high, _H_LEFT, _H_WIDTH - 16), Scale(0, float(counts.max()) * 1.08, _H_BOTTOM, _H_TOP)
    parts = y_axis(y, _H_LEFT, _H_WIDTH - 16, "answers", [v for v in ticks(0, y.high, 5) if v == round(v)])
    parts += x_axis(x, _H_TOP, _H_BOTTOM, words, 6)
    for count, (left, right) in zip(counts, pairwise(edges), strict=True):
        if count:
            parts.append(rect(x(left) + 0.6, y(count), x(right) - x(left) - 1.2, _H_BOTTOM - y(count), "bar", f"{count} answers"))
    median, p95 = np.percentile(values_ms, (50, 95))
    parts += _percentile(x, median, "median", _H_TOP - 30) + _percentile(x, p95, "95 % within", _H_TOP - 8)
    return figure(_H_WIDTH, _H_HEIGHT, parts, "Histogram of latencies", "half")


def _percentile(x: Scale, value: float, name: str, y: float) -> list[str]:
    at = x(value)
    side, anchor = (-7, "end") if at > _H_WIDTH * 0.6 else (7, "start")
    return [line(at, y - 12, at, _H_BOTTOM, "cut"), text(at + side, y, f"{name} {value:.0f} ms", "over", anchor)]
