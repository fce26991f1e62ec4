"""`visloc demo`: a whole flight through GNSS spoofing and jamming, ending with a report and a PASS or FAIL line."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from visloc_companion.evaluate.demonstration.demo import DemoResult


def demo(
    out: Annotated[Path, typer.Option(help="Folder for the report, the journal and the logs.")] = Path("demo-out"),
    dialect: Annotated[str, typer.Option(help="What the built-in autopilot behaves like: ardupilot or px4.")] = "ardupilot",
    speed: Annotated[
        float | None, typer.Option(min=0.25, max=4.0, help="Times real time; 2 unless given, less on a busy or slow computer.")
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures here.")] = None,
) -> None:
    """Fly through spoofing and jamming on the embedded procedural world. Exit code 1 when a requirement is missed."""
    from visloc_companion.cli.progress import make_folder, require_folder, results_into, spinner, write_json
    from visloc_companion.errors import ConfigError
    from visloc_companion.evaluate.demonstration.demo import run_demo
    from visloc_companion.types import AutopilotKind

    if dialect not in ("ardupilot", "px4"):
        raise ConfigError(f"unknown dialect {dialect!r}", remedy="ardupilot or px4")
    make_folder(out, "--out")
    require_folder(json_file, "--json")
    with spinner("demo") as tell, results_into(out, "--out"):
        result = run_demo(out, AutopilotKind(dialect), speed, tell)
    try:
        _tell(result)
    finally:  # a reader of the words that went away must not cost the figures
        if json_file is not None:
            write_json(json_file, result.as_json())
    if not result.passed:
        raise typer.Exit(1)


def _tell(result: DemoResult) -> None:
    checks = result.flown.checks
    for check in checks:
        typer.echo(f"{'ok  ' if check.passed else 'FAIL'} {check.name}: {check.value} (required {check.limit})")
    if not result.passed:
        unknown = "is not known to have been busy or not: run it again with nothing beside it"
        typer.echo(f"the computer {unknown if result.waits is None else result.waits.told()}")
    typer.echo(f"report: {result.report}")
    figures = {check.name: check.value for check in checks}
    typer.echo(
        f"{'PASS' if result.passed else 'FAIL'}: without GNSS median {figures['median error without GNSS']}, "
        f"largest {figures['largest error without GNSS']}; spoof pulled {figures['pulled by false GNSS']}; "
        f"failsafe {figures['failsafe']}; without the daemon {figures['autopilot off without the daemon']} off"
    )
