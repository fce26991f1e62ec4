"""A self-contained HTML report of a cloud evaluation: results by place, whether the claims hold, the worst cases in pictures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from visloc_companion.evaluate.clouds.cloud_cases import BadCloudCase, CloudCase, read_cloud_cases, read_cloud_truth
from visloc_companion.evaluate.clouds.cloud_metrics import FAR_M, WRONG_M, CloudResult
from visloc_companion.evaluate.clouds.cloud_pictures import CloudPictures, cloud_pictures
from visloc_companion.evaluate.reliability import reliability, reliability_diagram
from visloc_companion.evaluate.reports.report_parts import (
    case_section,
    claims_words,
    figures_table,
    html_page,
    percent,
    rounded,
    sigma_scatter,
    tiles,
    worst_cases_section,
)
from visloc_companion.evaluate.reports.report_svg import legend
from visloc_companion.types import FloatArray
from visloc_companion.whole_file import write_result

LISTED = 400
WORST = 10


def write_cloud_report(folder: Path, document: dict[str, Any], results: Sequence[CloudResult], cases_folder: Path) -> Path:
    """Write `report.html` and `result.json` into a folder, which is made; returns the page's path.

    The clouds of the worst cases are read again for their pictures.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_result(folder / "result.json", json.dumps(document, indent=1, allow_nan=False).encode())
    summary = dict(document["summary"])
    places = summary.pop("by_place", {})
    title = f"Cloud evaluation, method {document['method']}"
    parts = [
        f"<h1>{escape(title)}</h1>",
        _tiles(summary),
        _places_table(places),
        _claims(results),
        _worst_section(results, cases_folder),
        _cases_table(results),
        figures_table(summary),
    ]
    footnote = "MTRE: mean distance of the source's points under the found and the true transform."
    path = folder / "report.html"
    write_result(path, html_page(title, parts, footnote).encode())
    return path


def worst_cases(results: Sequence[CloudResult], count: int) -> list[CloudResult]:
    """Accepted far-off fixes first, then the other answers by their MTRE."""
    answers = [(r.fix is not None and r.error.far, r.error.mtre_m, r) for r in results if r.error is not None]
    return [r for _, _, r in sorted(answers, key=lambda item: item[:2], reverse=True)[:count]]


def _tiles(summary: dict[str, Any]) -> str:
    shown = [(str(summary["n"]), "cases"), (percent(summary["fix_share"]), "answered with a fix")]
    if "n_with_truth" in summary:
        mtre, horizontal = summary["mtre_m"] or {}, summary["horizontal_m"] or {}
        shown += [
            (percent(summary["within_5m_share"]), "of all cases within 5 m (MTRE)"),
            (percent(summary["within_5m_of_fixes_share"]), "of the fixes within 5 m (MTRE)"),
            (rounded(mtre.get("mean"), " m"), "mean MTRE of the fixes"),
            (rounded(mtre.get("median"), " m"), "median MTRE of the fixes"),
            (rounded(horizontal.get("mean"), " m"), "mean horizontal error of the fixes"),
            (rounded(horizontal.get("median"), " m"), "median horizontal error of the fixes"),
            (str(summary["far_and_accepted"]), f"accepted, but off by more than {FAR_M:g} m (MTRE)"),
            (
                percent(summary["inside_95_ellipse_share"]),
                f"of the errors up to {FAR_M:g} m (MTRE) inside the claimed 95 % ellipse",
            ),
        ]
    if summary["elapsed_ms"]:
        shown.append((rounded(summary["elapsed_ms"]["median"], " ms", 0), "median time"))
    return tiles(shown)


def _places_table(places: dict[str, dict[str, Any]]) -> str:
    if not places:
        return ""
    head = "".join(
        f"<th class=n>{h}</th>"
        for h in ("cases", "fixes", "&lt; 5 m", "&lt; 1 m", "MTRE mean", "median", "horizontal mean", "median", "far, accepted")
    )
    body = ""
    for name, figures in places.items():
        mtre, horizontal = figures["mtre_m"] or {}, figures["horizontal_m"] or {}
        cells = (
            *(str(figures["n_with_truth"]), str(figures["n_answered"])),
            *(percent(figures[share]) for share in ("within_5m_share", "within_1m_share")),
            *(rounded(spread.get(key)) for spread in (mtre, horizontal) for key in ("mean", "median")),
            str(figures["far_and_accepted"]),
        )
        body += f"<tr><td class=name>{escape(name)}</td>{''.join(f'<td class=n>{cell}</td>' for cell in cells)}</tr>"
    return (
        "<h2>By place</h2><p class=soft>Shares are of all cases, by MTRE; what is refused is not within. Errors are those of the "
        f"fixes, metres.</p><div class=scroll><table><tr><th></th>{head}</tr>{body}</table></div>"
    )


def _claims(results: Sequence[CloudResult]) -> str:
    judged = [(r.answer.probability_wrong, r.error) for r in results if r.answer is not None and r.error is not None]
    if not judged:
        return ""
    p, wrong = np.array([claim for claim, _ in judged]), np.array([e.wrong for _, e in judged])
    words = claims_words(reliability(p, wrong), f"off by more than {WRONG_M:g} m horizontally")
    key = legend([("dotmark", "share that is wrong, by bin"), ("level", "what chance allows"), ("limit", "a true claim")])
    dots = legend([("dotfix", f"within {WRONG_M:g} m"), ("dotgnss", "wrong")])
    scatter = sigma_scatter([(float(e.sigmas[0]), float(e.sigmas[1]), e.wrong) for _, e in judged])
    return (
        f"<h2>Are the claims true?</h2><p>{escape(words)} Refused answers are judged as well.</p>"
        f'<div class="two"><div><h3>Probability of being wrong</h3>{key}{reliability_diagram(p, wrong)}'
        "<p class=soft>Bars: number of answers, on a logarithmic scale.</p></div>"
        f"<div><h3>Error over claimed sigma</h3>{dots}{scatter}</div></div>"
    )


def _worst_section(results: Sequence[CloudResult], folder: Path) -> str:
    by_id: dict[str, CloudCase | BadCloudCase] = {case.case_id: case for case in read_cloud_cases(folder)}
    truth: dict[str, FloatArray] = read_cloud_truth(folder)
    shown = []
    for result in worst_cases(results, WORST):
        found = None if result.answer is None else result.answer.T_reference_source
        pictures = cloud_pictures(by_id[result.case_id], truth.get(result.case_id), found)
        if pictures is not None:
            shown.append(_one(result, pictures))
    return worst_cases_section(shown)


def _one(result: CloudResult, pictures: CloudPictures) -> str:
    error, answer = result.error, result.answer
    off = (
        "" if error is None else f"{error.mtre_m:.1f} m off ({error.horizontal_m:.1f} m horizontally, {error.off_m[2]:+.1f} m up)"
    )
    claim = "" if answer is None else f", claimed p {answer.probability_wrong:.3g}"
    verdict = "accepted" if result.fix is not None else "refused"
    shots = (
        (pictures.source_at_truth, "source, placed by the truth"),
        (pictures.reference_at_truth, "reference at the truth"),
        (pictures.source_at_answer, "source, placed by the answer"),
        (pictures.reference_at_answer, "reference at the answer"),
        (pictures.difference, "source less reference at the answer, red above, ±5 m"),
    )
    evidence = ", ".join(f"{name} {value:.3g}" for name, value in result.evidence)
    return case_section(result.case_id, f"{off}{claim} ({verdict})", evidence, shots)


def _cases_table(results: Sequence[CloudResult]) -> str:
    names = ("MTRE m", "horizontal m", "sigma m", "p wrong", "ms")
    head = "".join(f"<th class=n>{name}</th>" for name in names)
    rows = "".join(_case_row(result) for result in results[:LISTED])
    more = f"<p class=soft>The first {LISTED} of {len(results)}.</p>" if len(results) > LISTED else ""
    return f"<h2>Cases</h2>{more}<div class=scroll><table><tr><th>case</th><th>status</th>{head}</tr>{rows}</table></div>"


def _case_row(result: CloudResult) -> str:
    name, answer, error = escape(result.case_id), result.answer, result.error
    errors = [f"{error.mtre_m:.2f}", f"{error.horizontal_m:.2f}"] if error else ["", ""]
    sigma = f"{np.sqrt(np.diag(answer.covariance_m2)[:2].max()):.2f}" if answer else ""
    claim = f"{answer.probability_wrong:.2g}" if answer else ""
    cells = "".join(f"<td class=n>{cell}</td>" for cell in (*errors, sigma, claim, f"{result.elapsed_ms:.0f}"))
    if result.fix is None:
        title = escape(result.detail, quote=True)
        return f'<tr class=soft title="{title}"><td class=name>{name}</td><td>{result.reason}</td>{cells}</tr>'
    status = '<td class="no">wrong</td>' if error and error.wrong else "<td>fix</td>"
    return f"<tr><td class=name>{name}</td>{status}{cells}</tr>"
