"""A self-contained HTML report of an image evaluation: results, whether the claims hold, what errors depend on."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from visloc_companion import __version__
from visloc_companion.evaluate.cases import BadCase, Case, Truth
from visloc_companion.evaluate.image_breakdown import GroupFigures, breakdown, grounds_under
from visloc_companion.evaluate.image_metrics import CaseResult, accepted, case_error, claims
from visloc_companion.evaluate.image_worst import worst_section
from visloc_companion.evaluate.reliability import reliability, reliability_diagram
from visloc_companion.evaluate.report_style import CSS
from visloc_companion.evaluate.report_svg import circle, figure, legend, text

LISTED = 400
Judged = tuple[CaseResult, Truth]
_STYLE = (
    ".cases{display:grid;gap:18px}.case{background:var(--panel);border-radius:8px;padding:10px 12px}"
    ".shots{display:grid;grid-template-columns:repeat(auto-fit,minmax(150px,1fr));gap:10px;max-width:960px;margin-top:6px}"
    ".shots figure{margin:0}.shots img{width:100%;display:block;border-radius:4px}figcaption{color:var(--soft);font-size:13px}"
    ".ring{fill:none;stroke:var(--soft)}.dotmark{fill:var(--estimate)}"
)


def write_image_report(
    folder: Path,
    document: dict[str, Any],
    results: list[CaseResult],
    truth: dict[str, Truth],
    *,
    cases: Sequence[Case | BadCase] = (),
    max_probability_wrong: float = 1.0,
) -> Path:
    """Write `report.html` and `result.json` into a folder, which is made; returns the page's path.

    `results` may hold answers of any claim; those beyond `max_probability_wrong` count as refused, but they are judged in the
    reliability diagram and among the worst. With `cases` the page shows land cover and pictures of the worst.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "result.json").write_text(json.dumps(document, indent=1, allow_nan=False), encoding="utf-8")
    judged = [(r, truth[r.case_id]) for r in results if r.case_id in truth]
    by_id = {case.case_id: case for case in cases}
    grounds = grounds_under(judged, by_id)
    title = f"Image evaluation, method {document['method']}"
    parts = [
        f"<h1>{escape(title)}</h1>",
        _tiles(document["summary"]),
        _reliability(judged),
        _breakdown_table(breakdown(judged, grounds, max_probability_wrong)),
        worst_section(judged, by_id, max_probability_wrong),
        _cases_table(accepted(results, max_probability_wrong), truth),
        f"<h2>All figures</h2><div class=scroll><table>{_rows(document['summary'])}</table></div>",
        f"<footer>visloc-companion {escape(__version__)}. Errors in pixels are those of the map.</footer>",
    ]
    page = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1"><link rel="icon" href="data:,">'
        f"<title>{escape(title)}</title><style>{CSS}{_STYLE}</style></head><body><main>{''.join(parts)}</main></body></html>\n"
    )
    path = folder / "report.html"
    path.write_text(page, encoding="utf-8")
    return path


def _tiles(summary: dict[str, Any]) -> str:
    tiles = [(str(summary["n"]), "cases"), (_percent(summary["fix_share"]), "answered with a fix")]
    if "n_with_truth" in summary:
        error = summary["error_px"] or {}
        tiles += [
            (_percent(summary["within_5px_share"]), "of the solvable within 5 px"),
            (_number(error.get("mean"), " px"), "mean error of the fixes"),
            (_number(error.get("p95"), " px"), "95 % of the errors below"),
            (str(summary["far_and_accepted"]), "accepted, but off by more than 10 px or without a right answer"),
            (_percent(summary["refused_of_unsolvable_share"]), "of the unsolvable refused"),
            (_percent(summary["inside_95_ellipse_share"]), "of the errors inside the claimed 95 % ellipse"),
        ]
    if summary["elapsed_ms"]:
        tiles.append((_number(summary["elapsed_ms"]["median"], " ms", 0), "median time"))
    cells = "".join(f'<div class="tile"><b>{escape(value)}</b><span>{escape(words)}</span></div>' for value, words in tiles)
    return f'<div class="tiles">{cells}</div>'


def _reliability(judged: Sequence[Judged]) -> str:
    p, wrong = claims(list(judged))
    if not len(p):
        return ""
    figures = reliability(p, wrong)
    separation = figures["separation"]
    words = (
        f"{figures['n']} answers, {figures['n_wrong']} of them wrong (5 px and more), by their claims "
        f"{figures['claimed_wrong']:.1f}. Expected calibration error {figures['expected_calibration_error']:.4f}, "
        f"excess of wrong ones {figures['excess_sigmas']:+.1f} standard deviations of chance"
        + ("." if separation is None else f", area under the ROC curve {separation:.4f}.")
    )
    key = legend([("dotmark", "share that is wrong, by bin"), ("level", "what chance allows"), ("limit", "a true claim")])
    return (
        f'<h2>Are the claims true?</h2><p>{escape(words)}</p><div class="two"><div><h3>Probability of being wrong</h3>'
        f"{key}{reliability_diagram(p, wrong)}<p class=soft>Bars: number of answers, on a logarithmic scale.</p></div>"
        f"<div><h3>Error over claimed sigma</h3>{_scatter(judged)}</div></div>"
    )


def _scatter(judged: Sequence[Judged]) -> str:
    """Error over sigma, north against east, with the 1, 2 and 3 sigma circles; far errors lie on the rim."""
    errors = [e for r, t in judged if (e := case_error(r, t)) is not None and e.solvable]
    parts = [f'<circle cx="300" cy="300" r="{60 * k}" class="ring"/>' for k in (1, 2, 3)]
    for e in errors:
        east, north = (max(-4.8, min(4.8, e.sigmas[k])) for k in (1, 0))
        parts.append(circle(300 + 60 * east, 300 - 60 * north, 3.2, "dotgnss" if e.wrong else "dotfix"))
    key = legend([("dotfix", "within 5 px"), ("dotgnss", "wrong")])
    return key + figure(
        600, 600, [*parts, text(300, 592, "east, over sigma"), text(60, 24, "north")], "Errors over sigma", "half"
    )


def _breakdown_table(rows: Sequence[GroupFigures]) -> str:
    if not rows:
        return ""
    body, group = "", ""
    for r in rows:
        if r.group != group:
            body += f'<tr><th colspan="7">{escape(r.group)}</th></tr>'
            group = r.group
        cells = (str(r.n), _percent(r.within_5px), _percent(r.within_2px), _number(r.error_px), str(r.accepted), str(r.far))
        body += f"<tr><td>{escape(r.label)}</td>{''.join(f'<td class=n>{cell}</td>' for cell in cells)}</tr>"
    head = "".join(f"<th class=n>{h}</th>" for h in ("cases", "&lt; 5 px", "&lt; 2 px", "mean px", "accepted", "of these far"))
    return (
        "<h2>What the errors depend on</h2><p class=soft>Solvable cases; accuracy is that of all answers. Cover: water where "
        "more than half of the footprint is, shore above 15 %, else rough (woods, wetland, towns) or smooth (fields, grass) by "
        "local deviation.</p>"
        f"<div class=scroll><table><tr><th></th>{head}</tr>{body}</table></div>"
    )


def _cases_table(results: Sequence[CaseResult], truth: dict[str, Truth]) -> str:
    head = "".join(f"<th class=n>{h}</th>" for h in ("error px", "error m", "sigma m", "p wrong", "ms"))
    rows = "".join(_case_row(result, truth.get(result.case_id)) for result in results[:LISTED])
    more = f"<p class=soft>The first {LISTED} of {len(results)}.</p>" if len(results) > LISTED else ""
    return f"<h2>Cases</h2>{more}<div class=scroll><table><tr><th>case</th><th>status</th>{head}</tr>{rows}</table></div>"


def _case_row(result: CaseResult, truth: Truth | None) -> str:
    name, fix = escape(result.case_id), result.fix
    if fix is None:
        blank = "<td></td>" * 4
        refusal = f"<td>{name}</td><td>{escape(str(result.reason))}</td>{blank}<td class=n>{result.elapsed_ms:.0f}</td>"
        return f"<tr class=soft>{refusal}</tr>"
    error = case_error(result, truth) if truth else None
    errors = [f"{error.horizontal_px:.2f}", f"{error.horizontal_m:.2f}"] if error else ["", ""]
    sigma = max(fix.cov_ne_m2[0][0], fix.cov_ne_m2[1][1]) ** 0.5
    cells = [*errors, f"{sigma:.2f}", f"{fix.probability_wrong:.2g}", f"{result.elapsed_ms:.0f}"]
    status = '<td class="no">wrong</td>' if error and error.wrong else "<td>fix</td>"
    return f"<tr><td>{name}</td>{status}{''.join(f'<td class=n>{cell}</td>' for cell in cells)}</tr>"


def _rows(summary: dict[str, Any]) -> str:
    return "".join(f"<tr><td>{escape(name)}</td><td>{escape(_text(value))}</td></tr>" for name, value in summary.items())


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k} {_text(v)}" for k, v in value.items())
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.1f} %"


def _number(value: float | None, unit: str = "", digits: int = 2) -> str:
    return "–" if value is None else f"{value:.{digits}f}{unit}"
