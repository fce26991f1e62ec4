"""A self-contained HTML report of an image evaluation: the summary, the errors over the claimed sigmas, every case."""

from __future__ import annotations

import html
import json
from pathlib import Path
from typing import Any

from visloc_companion.evaluate.cases import Truth
from visloc_companion.evaluate.image_metrics import CaseResult, case_error

_STYLE = (
    "body{font:14px/1.5 system-ui,sans-serif;margin:2em auto;max-width:70em;color:#222}table{border-collapse:collapse}"
    "td,th{padding:.2em .7em;border-bottom:1px solid #ddd;text-align:right}td:first-child,th:first-child{text-align:left}"
    ".wrong{background:#fdd}.none{color:#888}svg{background:#fafafa;border:1px solid #ddd}"
)


def write_image_report(folder: Path, document: dict[str, Any], results: list[CaseResult], truth: dict[str, Truth]) -> Path:
    """Write `report.html` and `result.json` into a folder, which is made; returns the page's path."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "result.json").write_text(json.dumps(document, indent=1, allow_nan=False), encoding="utf-8")
    rows = "".join(_row(result, truth.get(result.case_id)) for result in results)
    page = (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>visloc evaluate image</title><style>{_STYLE}</style>"
        f"<h1>Image evaluation, method {html.escape(str(document['method']))}</h1>"
        f"{_summary_table(document['summary'])}{_scatter(results, truth)}"
        "<h2>Cases</h2><table><tr><th>case<th>status<th>error px<th>error m<th>protection level m<th>p wrong<th>ms</tr>"
        f"{rows}</table></html>"
    )
    path = folder / "report.html"
    path.write_text(page, encoding="utf-8")
    return path


def _summary_table(summary: dict[str, Any]) -> str:
    rows = "".join(f"<tr><td>{html.escape(name)}<td>{html.escape(_text(value))}</tr>" for name, value in summary.items())
    return f"<table>{rows}</table>"


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k} {_text(v)}" for k, v in value.items())
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _row(result: CaseResult, truth: Truth | None) -> str:
    name = html.escape(result.case_id)
    fix = result.fix
    if fix is None:
        return f"<tr class=none><td>{name}<td>{html.escape(str(result.reason))}<td><td><td><td><td>{result.elapsed_ms:.0f}</tr>"
    error = case_error(result, truth) if truth else None
    errors = f"<td>{error.horizontal_px:.2f}<td>{error.horizontal_m:.2f}" if error else "<td><td>"
    sigma = max(fix.cov_ne_m2[0][0], fix.cov_ne_m2[1][1]) ** 0.5
    style = " class=wrong" if error and error.wrong else ""
    claimed = f"<td>{4.8 * sigma:.2f}<td>{fix.probability_wrong:.2g}<td>{result.elapsed_ms:.0f}"
    return f"<tr{style}><td>{name}<td>fix{errors}{claimed}</tr>"


def _scatter(results: list[CaseResult], truth: dict[str, Truth]) -> str:
    """Error over sigma, north against east, with the 1, 2 and 3 sigma circles."""
    errors = [case_error(r, truth[r.case_id]) for r in results if r.case_id in truth]
    dots = "".join(
        f'<circle cx="{150 + 30 * max(-4.9, min(4.9, e.sigmas[1])):.1f}" cy="{150 - 30 * max(-4.9, min(4.9, e.sigmas[0])):.1f}" '
        f'r="2.5" fill="{"#c00" if e.wrong else "#06c"}" fill-opacity="0.5"/>'
        for e in errors
        if e is not None
    )
    if not dots:
        return ""
    rings = "".join(f'<circle cx="150" cy="150" r="{30 * k}" fill="none" stroke="#bbb"/>' for k in (1, 2, 3))
    return f'<h2>Error over claimed sigma</h2><svg width="300" height="300" role="img">{rings}{dots}</svg>'
