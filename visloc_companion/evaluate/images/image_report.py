"""A self-contained HTML report of an image evaluation: results, whether the claims hold, what errors depend on."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from visloc_companion.evaluate.cases import BadCase, Case, Truth
from visloc_companion.evaluate.images.image_breakdown import GroupFigures, breakdown, grounds_under
from visloc_companion.evaluate.images.image_metrics import FAR_PX, CaseResult, accepted, case_error, claims
from visloc_companion.evaluate.images.image_worst import worst_section
from visloc_companion.evaluate.reliability import reliability, reliability_diagram
from visloc_companion.evaluate.reports.report_parts import (
    claims_words,
    figures_table,
    html_page,
    percent,
    rounded,
    sigma_scatter,
    tiles,
)
from visloc_companion.evaluate.reports.report_svg import legend
from visloc_companion.whole_file import write_result

LISTED = 400
Judged = tuple[CaseResult, Truth]


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
    write_result(folder / "result.json", json.dumps(document, indent=1, allow_nan=False).encode())
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
        figures_table(document["summary"]),
    ]
    path = folder / "report.html"
    write_result(path, html_page(title, parts, "Errors in pixels are those of the map.").encode())
    return path


def _tiles(summary: dict[str, Any]) -> str:
    shown = [(str(summary["n"]), "cases"), (percent(summary["fix_share"]), "answered with a fix")]
    if "n_with_truth" in summary:
        error = summary["error_px"] or {}
        shown += [
            (percent(summary["within_5px_share"]), "of the solvable within 5 px"),
            (rounded(error.get("mean"), " px"), "mean error of the fixes"),
            (rounded(error.get("p95"), " px"), "95 % of the errors below"),
            (str(summary["far_and_accepted"]), f"accepted, but off by more than {FAR_PX:g} px or without a right answer"),
            (percent(summary["refused_of_unsolvable_share"]), "of the unsolvable refused"),
            (percent(summary["inside_95_ellipse_share"]), f"of the errors up to {FAR_PX:g} px inside the claimed 95 % ellipse"),
        ]
    if summary["elapsed_ms"]:
        shown.append((rounded(summary["elapsed_ms"]["median"], " ms", 0), "median time"))
    return tiles(shown)


def _reliability(judged: Sequence[Judged]) -> str:
    p, wrong = claims(list(judged))
    if not len(p):
        return ""
    figures = reliability(p, wrong)
    words = claims_words(figures, "5 px and more")
    key = legend([("dotmark", "share that is wrong, by bin"), ("level", "what chance allows"), ("limit", "a true claim")])
    return (
        f'<h2>Are the claims true?</h2><p>{escape(words)}</p><div class="two"><div><h3>Probability of being wrong</h3>'
        f"{key}{reliability_diagram(p, wrong)}<p class=soft>Bars: number of answers, on a logarithmic scale.</p></div>"
        f"<div><h3>Error over claimed sigma</h3>{_scatter(judged)}</div></div>"
    )


def _scatter(judged: Sequence[Judged]) -> str:
    """Error over sigma, north against east, with the 1, 2 and 3 sigma circles; far errors lie on the rim."""
    errors = [e for r, t in judged if (e := case_error(r, t)) is not None and e.solvable]
    key = legend([("dotfix", "within 5 px"), ("dotgnss", "wrong")])
    return key + sigma_scatter([(e.sigmas[1], e.sigmas[0], e.wrong) for e in errors])


def _breakdown_table(rows: Sequence[GroupFigures]) -> str:
    if not rows:
        return ""
    body, group = "", ""
    for r in rows:
        if r.group != group:
            body += f'<tr><th colspan="7">{escape(r.group)}</th></tr>'
            group = r.group
        cells = (str(r.n), percent(r.within_5px), percent(r.within_2px), rounded(r.error_px), str(r.accepted), str(r.far))
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
        refusal = (
            f"<td class=name>{name}</td><td>{escape(str(result.reason))}</td>{blank}<td class=n>{result.elapsed_ms:.0f}</td>"
        )
        return f"<tr class=soft>{refusal}</tr>"
    error = case_error(result, truth) if truth else None
    errors = [f"{error.horizontal_px:.2f}", f"{error.horizontal_m:.2f}"] if error else ["", ""]
    sigma = max(fix.cov_ne_m2[0][0], fix.cov_ne_m2[1][1]) ** 0.5
    cells = [*errors, f"{sigma:.2f}", f"{fix.probability_wrong:.2g}", f"{result.elapsed_ms:.0f}"]
    status = '<td class="no">wrong</td>' if error and error.wrong else "<td>fix</td>"
    return f"<tr><td class=name>{name}</td>{status}{''.join(f'<td class=n>{cell}</td>' for cell in cells)}</tr>"
