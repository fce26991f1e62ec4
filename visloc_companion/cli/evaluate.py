"""`visloc evaluate`: measure the methods on cases with known truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from visloc_companion.cli.evaluate_choice import chosen_cases
from visloc_companion.cli.evaluate_cloud import cloud

if TYPE_CHECKING:
    from visloc_companion.evaluate.images.map_sigma import MapSigma
    from visloc_companion.localise.runtime import NetworkChoice, ProviderName

evaluate_app = typer.Typer(
    help="Measure the methods on cases with known truth.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)
DEFAULT_METHOD = "deep"
"""config.DEFAULT_METHOD, which is not imported for it: --help is quick without pydantic."""


evaluate_app.command()(cloud)


@evaluate_app.command("image")
def image(
    cases: Annotated[Path | None, typer.Argument(help="Folder with cases.csv and, if known, truth.csv.")] = None,
    method: Annotated[str, typer.Option(help="Method; see --list-methods.")] = DEFAULT_METHOD,
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    limit: Annotated[int | None, typer.Option(min=1, help="Only the first so many cases.")] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the result here.")] = None,
    model: Annotated[Path | None, typer.Option(help="Folder of a network, instead of the one that came with it.")] = None,
    provider: Annotated[
        list[str] | None, typer.Option(help="What the network may compute on, in order of wish (repeat it); cpu by default.")
    ] = None,
    map_sigma_m: Annotated[
        str | None, typer.Option(help="The map's own horizontal error, 1-sigma: of both axes, or 'north,east'.")
    ] = None,
    map_sigma_h_m: Annotated[float | None, typer.Option(min=0, max=1000, help="The same of its heights.")] = None,
    report: Annotated[Path | None, typer.Option(help="Folder for report.html.")] = None,
    list_methods: Annotated[bool, typer.Option("--list-methods", help="Print the methods of this version.")] = False,
) -> None:
    """Place frames on a map: fixes, errors against the truth, claimed accuracy and time."""
    from visloc_companion.errors import ConfigError
    from visloc_companion.evaluate.images.map_sigma import stated
    from visloc_companion.localise.registry import METHODS, needs_features
    from visloc_companion.localise.runtime import NetworkChoice

    folder = chosen_cases(cases, method, METHODS, list_methods, "visloc evaluate image FOLDER (with cases.csv)")
    if folder is not None:
        providers = _providers(provider or ["cpu"])
        if not needs_features(method) and (model is not None or provider):
            raise ConfigError(
                f"means nothing with --method {method}, which has no network",
                where="--provider" if model is None else "--model",
                remedy=f"leave it out, or name {DEFAULT_METHOD}",
            )
        network = NetworkChoice(model, providers)
        _run(folder, method, jobs, limit, json_file, report, network, stated(map_sigma_m, map_sigma_h_m))


def _providers(names: list[str]) -> tuple[ProviderName, ...]:
    from visloc_companion.errors import ConfigError
    from visloc_companion.localise.runtime import PROVIDERS

    if unknown := [name for name in names if name not in PROVIDERS]:
        raise ConfigError(f"unknown provider {unknown[0]!r}", where="--provider", remedy=f"use one of {', '.join(PROVIDERS)}")
    return tuple(cast("list[ProviderName]", names))


def _run(
    cases: Path,
    method: str,
    jobs: int,
    limit: int | None,
    json_file: Path | None,
    report: Path | None,
    network: NetworkChoice,
    map_sigma: MapSigma,
) -> None:
    from rich.console import Console
    from rich.progress import Progress

    from visloc_companion.cli.figures import end_if_broken_off, figure_lines
    from visloc_companion.cli.progress import make_folder, require_folder, results_into, write_json
    from visloc_companion.errors import Reason
    from visloc_companion.evaluate.cases import read_by, read_cases, read_truth
    from visloc_companion.evaluate.ended_in_order import BrokenOff, ended_in_order
    from visloc_companion.evaluate.images.image import evaluate_image
    from visloc_companion.evaluate.images.image_report import write_image_report

    make_folder(report, "--report")
    require_folder(json_file, "--json", cases, cases / "cases.csv", cases / "truth.csv")
    if json_file is not None:
        require_folder(json_file, "--json", *read_by(cases))
    broken_off = None
    with ended_in_order(), Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(method, total=None)
        try:
            document, results = evaluate_image(
                cases,
                method,
                jobs,
                limit,
                lambda done, total: bar.update(task, completed=done, total=total),
                network=network,
                map_sigma=map_sigma,
            )
        except BrokenOff as why:
            broken_off, document, results = why.why, why.document, why.results
    for result in results:
        if result.reason in (Reason.BAD_INPUT, Reason.BAD_FRAME):
            typer.echo(f"{result.case_id}: {result.detail}", err=True)
    for warning in document.get("warnings", ()):
        typer.echo(f"WARNING: {warning}", err=True)
    try:
        if json_file is not None:
            write_json(json_file, document)
        if report is not None:
            with results_into(report, "--report"):
                typer.echo(
                    write_image_report(report, document, results, read_truth(cases), cases=read_cases(cases)[: len(results)])
                )
    finally:  # a full disk must not cost the figures
        for line in figure_lines(document["summary"]):
            typer.echo(line)
    end_if_broken_off(broken_off, document)
