"""The report of a flight: one HTML file with nothing outside of it, for whoever must decide whether to trust the system."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any, Literal

import numpy as np

from visloc_companion import __version__
from visloc_companion.core.terrain.terrain_aiding import METHOD as TERRAIN
from visloc_companion.evaluate.gate import Check
from visloc_companion.evaluate.metrics import (
    DEFAULT_ALERT_LIMIT_M,
    alarms_s,
    error_figures,
    fix_errors_m,
    flight_summary,
    judged_epochs,
    latency_ms,
)
from visloc_companion.evaluate.record import FixPoint, FlightRecord, Refusal, rebased
from visloc_companion.evaluate.reports.report_charts import latency_histogram, spans, time_chart, time_legend
from visloc_companion.evaluate.reports.report_map import MapImage, Moment, flight_map, flight_view, map_legend
from visloc_companion.evaluate.reports.report_pictures import PicturePair, picture_section
from visloc_companion.evaluate.reports.report_stanford import stanford_section
from visloc_companion.evaluate.reports.report_style import CSS
from visloc_companion.types import FloatArray, Verdict
from visloc_companion.whole_file import write_result

_DEFINITIONS = (
    ("Horizontal error", "distance between our estimate and the truth at one output tick."),
    ("1-sigma", "the error that the estimate itself claims, along the larger axis of its covariance."),
    ("Protection level", "the bound that the error is claimed to exceed only with the configured small risk."),
    ("Vertical level", "the same for the height that is stated: the autopilot's own, of its barometer."),
    ("Misleading epoch", "a tick at which the error exceeded the protection level."),
    ("HMI", "hazardously misleading: the error exceeded the alert limit while the protection level did not."),
    ("Availability", "share of ticks since the first estimate at which the protection level was within the alert limit."),
    ("NEES", "squared error over claimed covariance; 2 on average if the claim is right, more if it is too bold."),
)


_TILE_WORDS = {"arrival": "latency", "computation": "computation of an answer"}
_TABLE_WORDS = {"arrival": "median latency", "computation": "median computation"}
_LATENCY_WORDS = {"arrival": "latency from exposure to answer (ms)", "computation": "computation of an answer (ms)"}


def write_flight_report(
    record: FlightRecord,
    path: Path,
    *,
    title: str,
    checks: Sequence[Check] = (),
    baseline: FlightRecord | None = None,
    map_image: MapImage | None = None,
    alert_limit_m: float = DEFAULT_ALERT_LIMIT_M,
    gnss_faults_s: Sequence[tuple[float, float]] | None = None,
    notes: Sequence[str] = (),
    latency: Literal["arrival", "computation"] = "arrival",
    pictures: Sequence[PicturePair] = (),
) -> None:
    """Write the report of a flight.

    `checks` decide PASS or FAIL (none: neither is stated). `baseline` is the same flight without the daemon; of it only the true
    track is used. `map_image` lies under the tracks. `gnss_faults_s` are the intervals in which GNSS was really bad, where known.
    `notes` are paragraphs on what was flown. `latency` is as in `flight_summary`: a replay states the computation alone.
    `pictures` show frames beside the map.
    """
    summary = flight_summary(record, alert_limit_m=alert_limit_m, gnss_faults_s=gnss_faults_s, latency=latency)
    strayed = _strayed(record, baseline) if baseline is not None else None
    parts = [
        f"<h1>{escape(title)}</h1>",
        *(f'<p class="soft">{escape(note)}</p>' for note in notes),
        _headline(record, summary, checks),
        _tiles(record, summary, alert_limit_m, latency),
        _checks_table(checks),
        _maps(record, baseline, map_image, strayed, gnss_faults_s),
        picture_section(pictures),
        _over_time(record, alert_limit_m, strayed),
        stanford_section(record, alert_limit_m),
        _answers(record, summary, latency),
        _events(record),
        _definitions(),
        f"<footer>visloc-companion {escape(__version__)}. {_origin(record)}Times are seconds of the flight.</footer>",
    ]
    page = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<link rel="icon" href="data:,"><title>{escape(title)}</title><style>{CSS}</style></head>'
        f"<body><main>{''.join(parts)}</main></body></html>\n"
    )
    write_result(path, page.encode(errors="backslashreplace"))  # names of files may hold bytes that are no UTF-8


def _headline(record: FlightRecord, summary: dict[str, Any], checks: Sequence[Check]) -> str:
    failed = [check for check in checks if not check.passed]
    state, word = ("open", "NO GATE") if not checks else ("fail", "FAIL") if failed else ("pass", "PASS")
    denied = error_figures(record, record.while_verdict(Verdict.DENIED, Verdict.SUSPECT))
    n_terrain = sum(fix.method == TERRAIN for fix in record.fixes)
    profiles = f" and {n_terrain} from profiles of the ground" if n_terrain else ""
    seen = f"{summary['n_fixes'] - n_terrain} fixes from {summary['n_frames']} frames{profiles}"
    sentences = [f"{summary['duration_s']:.0f} s of flight, {seen}."]
    if denied["max"] is not None:
        sentences.append(
            f"While GNSS was not trusted the error was {_m(denied['median'])} (median) and {_m(denied['max'])} (maximum)."
        )
    if failed:
        sentences.append(f"Not met: {', '.join(check.name for check in failed)}.")
    return f'<section class="verdict {state}"><span class="badge">{word}</span><div>{escape(" ".join(sentences))}</div></section>'


def _tiles(
    record: FlightRecord, summary: dict[str, Any], alert_limit_m: float, latency: Literal["arrival", "computation"]
) -> str:
    error, n_judged = summary["error_horizontal_m"], judged_epochs(record)
    tiles = [
        (_m(error["median"]), "median horizontal error"),
        (_m(error["p95"]), "95 % of errors below"),
        (_m(error["max"]), "largest error"),
        (_count(summary["hmi"]), f"HMI epochs (alert limit {alert_limit_m:g} m)"),
        (_count(summary["misleading"]), f"misleading of {n_judged} epochs with truth"),
        (_share(summary["availability"]), "availability"),
        (_plain(summary["nees"], "{:.2f}"), "NEES (2 is right)"),
        (_plain(summary["gnss"]["detected_at_s"], "{:.1f} s"), "GNSS first declared bad"),
        (_plain(summary["injected"]["gap_max_ms"], "{:.0f} ms"), "longest injection gap"),
        (_plain(summary["latency_ms"]["p95"], "{:.0f} ms"), f"{_TILE_WORDS[latency]}, 95 % below"),
    ]
    cells = "".join(f'<div class="tile"><b>{escape(value)}</b><span>{escape(words)}</span></div>' for value, words in tiles)
    return f'<section class="tiles">{cells}</section>'


def _checks_table(checks: Sequence[Check]) -> str:
    if not checks:
        return ""
    rows = [
        (
            escape(check.name),
            _wrapping(_value(check.value)),
            _wrapping(check.limit),
            '<span class="yes">met</span>' if check.passed else '<span class="no">not met</span>',
        )
        for check in checks
    ]
    table = _table(("requirement", "measured|n", "limit|n", ""), rows)
    return f'<h2>What was required</h2><div class="scroll checks">{table}</div>'


def _maps(
    record: FlightRecord,
    baseline: FlightRecord | None,
    image: MapImage | None,
    strayed: tuple[FloatArray, FloatArray] | None,
    faults: Sequence[tuple[float, float]] | None,
) -> str:
    if not _is_anywhere(record) and baseline is None:
        return "<h2>Map</h2><p>Nobody knew a position in this flight.</p>"
    lost = _lost(record, faults)
    moved = rebased(baseline, record.origin) if baseline is not None else None
    view = flight_view(record, moved)
    own = _panel(
        "With the daemon" if moved is not None else "",
        flight_map(record, view, "Map of the flight", image, lost=lost),
        map_legend(record, view, "truth", "true track"),
    )
    if moved is None or strayed is None:
        return f"<h2>Map</h2><div class=two>{own}</div>"
    last = strayed[1][np.isfinite(strayed[1])]
    end = f": {last[-1]:.0f} m from the first at the end" if len(last) else ""
    other = _panel(
        f"The same flight without it{end}",
        flight_map(moved, view, "Map of the flight without the daemon", image, own="baseline", lost=lost),
        map_legend(moved, view, "baseline", "true track without the daemon"),
    )
    return f'<h2>Map</h2><div class="two">{own}{other}</div>'


def _origin(record: FlightRecord) -> str:
    place = f"{record.origin.lat_deg:.6f}°, {record.origin.lon_deg:.6f}°"
    return f"Positions are metres north and east of {place}. " if _is_anywhere(record) else ""


def _is_anywhere(record: FlightRecord) -> bool:
    tracks = (record.truth.p_ned_m, record.estimate_ned_m, record.gnss.p_ned_m)
    return any(bool(np.isfinite(track).all(axis=1).any()) for track in tracks)


def _lost(record: FlightRecord, faults: Sequence[tuple[float, float]] | None) -> Moment | None:
    """When GNSS went bad where that is known, else when it was called so, which may have been wrong."""
    if faults:
        return min(start for start, _ in faults), "GNSS bad from"
    return next(((t_s, "GNSS called bad at") for t_s in alarms_s(record)), None)


def _panel(heading: str, drawing: str, key: str) -> str:
    return f"<div>{f'<h3>{escape(heading)}</h3>' if heading else ''}{drawing}{key}</div>"


def _over_time(record: FlightRecord, alert_limit_m: float, strayed: tuple[FloatArray, FloatArray] | None) -> str:
    if not len(record.t_s):
        return "<h2>Errors, verdicts and modes over time</h2><p>No navigator ran in this flight.</p>"
    limit = alert_limit_m if np.isfinite(record.protection_level_m).any() else None
    chart = time_chart(record, limit, strayed)
    key = time_legend(record, limit, strayed is not None)
    return f'<h2>Errors, verdicts and modes over time</h2>{key}<div class="scroll">{chart}</div>'


def _answers(record: FlightRecord, summary: dict[str, Any], latency: Literal["arrival", "computation"]) -> str:
    answers: list[FixPoint | Refusal] = [*record.fixes, *record.refusals]
    if not answers:
        return "<h2>Fixes and latency</h2><p>No frame was localised in this flight.</p>"
    measures: tuple[Literal["arrival", "computation"], ...] = ("arrival", "computation") if latency == "arrival" else (latency,)
    kinds: dict[tuple[str, str], list[FixPoint | Refusal]] = defaultdict(list)
    for answer in answers:
        kinds[answer.method, f"no fix: {answer.reason}" if isinstance(answer, Refusal) else "fix"].append(answer)
    rows = [
        (
            escape(method),
            escape(name),
            _n(str(len(some))),
            _n(f"{100 * len(some) / len(answers):.1f} %"),
            *(_n(f"{np.median([latency_ms(each, which) for each in some]):.0f} ms") for which in measures),
        )
        for (method, name), some in sorted(kinds.items(), key=lambda item: -len(item[1]))
    ]
    table = _table(("method", "answer", "number|n", "share|n", *(f"{_TABLE_WORDS[which]}|n" for which in measures)), rows)
    n_terrain = sum(answer.method == TERRAIN for answer in answers)
    profiles = f"Profiles of the ground: {n_terrain} answers. " if n_terrain else ""
    counts = (
        f"<p>{record.n_frames} frames arrived, {record.n_requests} were asked to be localised, {len(answers) - n_terrain} were "
        f"answered. {profiles}{_off(record)}Injections: {summary['injected']['n']}.</p>"
    )
    values = (latency_ms(answer, latency) for answer in answers)
    finite = np.array([value for value in values if math.isfinite(value)], dtype=np.float64)
    chart = latency_histogram(finite, _LATENCY_WORDS[latency]) if len(finite) else ""
    return (
        f'<h2>Fixes and latency</h2><div class="two"><div>{counts}<div class="scroll">{table}</div></div><div>{chart}</div></div>'
    )


def _off(record: FlightRecord) -> str:
    off_m = fix_errors_m(record)
    off_m = off_m[np.isfinite(off_m)]
    if not len(off_m):
        return ""
    return f"Fixes are {_m(float(np.median(off_m)))} off (median), 95 % of them below {_m(float(np.percentile(off_m, 95)))}. "


def _events(record: FlightRecord) -> str:
    verdicts = [
        (_n(f"{start:.1f}"), escape(name), _n(f"{stop - start:.1f}"), escape(", ".join(_reasons(record, start, stop, name))))
        for start, stop, name in spans(record, record.verdicts)
    ]
    modes = [
        (_n(f"{start:.1f}"), escape(name.replace("_", " ")), _n(f"{stop - start:.1f}"))
        for start, stop, name in spans(record, record.modes)
    ]
    if not verdicts:
        return ""
    left = _titled("GNSS verdict", _table(("from s|n", "verdict", "for s|n", "reasons"), verdicts))
    right = _titled("Mode", _table(("from s|n", "mode", "for s|n"), modes))
    return f'<h2>Verdicts and modes</h2><div class="two">{left}{right}</div>'


def _reasons(record: FlightRecord, start_s: float, stop_s: float, verdict: str) -> list[str]:
    """Of the epochs of a verdict that lasted from one time to another all reasons, those that most epochs had first."""
    lasted = Counter[str]()
    for n in np.flatnonzero((record.t_s >= start_s) & (record.t_s <= stop_s)):
        if record.verdicts[n] == verdict:
            lasted.update(record.reasons[n])
    return [name for name, _ in lasted.most_common()]


def _titled(heading: str, table: str) -> str:
    return f'<div><h3>{heading}</h3><div class="scroll">{table}</div></div>'


def _definitions() -> str:
    items = "".join(f"<dt>{escape(name)}</dt><dd>{escape(words)}</dd>" for name, words in _DEFINITIONS)
    return f"<h2>What the figures mean</h2><dl>{items}</dl>"


def _strayed(record: FlightRecord, baseline: FlightRecord) -> tuple[FloatArray, FloatArray]:
    """(t_s, metres) between the true positions of two flights at the same time since their starts."""
    t_s = baseline.truth.t_s
    apart = rebased(baseline, record.origin).truth.p_ned_m[:, :2] - record.truth.at(t_s)[:, :2]
    return t_s, np.asarray(np.hypot(*apart.T), dtype=np.float64)


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    cells = [f'<th class="n">{head[:-2]}</th>' if head.endswith("|n") else f"<th>{head}</th>" for head in heads]
    body = "".join(f"<tr>{''.join(c if c.startswith('<td') else f'<td>{c}</td>' for c in row)}</tr>" for row in rows)
    return f"<table><thead><tr>{''.join(cells)}</tr></thead><tbody>{body}</tbody></table>"


def _n(words: str) -> str:
    return f'<td class="n">{escape(words)}</td>'


def _wrapping(words: str) -> str:
    """As `_n`, in more than one line on a phone."""
    return f'<td class="n wrap">{escape(words).replace("_", "_<wbr>")}</td>'


def _value(value: float | str | None) -> str:
    return "unknown" if value is None else value if isinstance(value, str) else f"{value:.4g}"


def _m(value: float | None) -> str:
    return _plain(value, "{:.2f} m" if value is not None and value < 10 else "{:.0f} m")


def _plain(value: float | None, layout: str) -> str:
    return "–" if value is None else layout.format(value)


def _count(value: int | None) -> str:
    return "–" if value is None else str(value)


def _share(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.1f} %"
