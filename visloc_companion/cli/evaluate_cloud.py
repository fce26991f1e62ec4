"""`visloc evaluate cloud`: register clouds with known truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from visloc_companion.cli.evaluate_choice import chosen_cases

DEFAULT_METHOD = "height-search"
"""registry.DEFAULT_METHOD, which is not imported for it: --help is quick without the libraries of the methods."""


def cloud(
    cases: Annotated[Path | None, typer.Argument(help="Folder with cases.json and, if known, truth.json.")] = None,
    method: Annotated[str, typer.Option(help="Method; see --list-methods.")] = DEFAULT_METHOD,
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    limit: Annotated[int | None, typer.Option(min=1, help="Only the first so many cases.")] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the result here.")] = None,
    report: Annotated[Path | None, typer.Option(help="Folder for report.html.")] = None,
    list_methods: Annotated[bool, typer.Option("--list-methods", help="Print the methods of this version.")] = False,
) -> None:
    """Place clouds in a georeferenced cloud by their shape: transforms, errors against the truth, claimed accuracy and time."""
    from visloc_companion.localise.registration.registry import METHODS

    folder = chosen_cases(cases, method, METHODS, list_methods, "visloc evaluate cloud FOLDER (with cases.json)")
    if folder is not None:
        _run(folder, method, jobs, limit, json_file, report)


def _run(cases: Path, method: str, jobs: int, limit: int | None, json_file: Path | None, report: Path | None) -> None:
    from visloc_companion.cli.figures import end_if_broken_off, figure_lines
    from visloc_companion.cli.progress import bar, make_folder, require_folder, results_into, write_json
    from visloc_companion.errors import Reason
    from visloc_companion.evaluate.clouds.cloud import evaluate_cloud
    from visloc_companion.evaluate.clouds.cloud_cases import read_by
    from visloc_companion.evaluate.clouds.cloud_report import write_cloud_report
    from visloc_companion.evaluate.ended_in_order import BrokenOff, ended_in_order

    make_folder(report, "--report")
    require_folder(json_file, "--json", cases, cases / "cases.json", cases / "truth.json")
    if json_file is not None:
        require_folder(json_file, "--json", *read_by(cases))
    broken_off = None
    with ended_in_order(), bar(method, 1.0) as advance:
        try:
            document, results = evaluate_cloud(cases, method, jobs, limit, lambda done, total: advance(done / total))
        except BrokenOff as why:
            broken_off, document, results = why.why, why.document, why.results
    for result in results:
        if result.detail and (result.fix is not None or result.reason is Reason.BAD_INPUT):
            typer.echo(f"{result.case_id}: {result.detail}", err=True)
    summary = dict(document["summary"])
    places = summary.pop("by_place", {})
    try:
        if json_file is not None:
            write_json(json_file, document)
        if report is not None:
            with results_into(report, "--report"):
                typer.echo(write_cloud_report(report, document, results, cases))
    finally:  # a full disk must not cost the figures
        for line in (*figure_lines(summary), *(_place_line(name, figures) for name, figures in places.items())):
            typer.echo(line)
    end_if_broken_off(broken_off, document)


def _place_line(name: str, figures: dict[str, Any]) -> str:
    horizontal = figures["horizontal_m"]
    median = "" if horizontal is None else f", median {horizontal['median']:.2f} m horizontally"
    accepted = f"{figures['n_answered']} of {figures['n_with_truth']} accepted"
    return f"{name:24} {accepted}{median}, {figures['far_and_accepted']} of these far off"
