"""`visloc doctor`: why would a vision position not be used?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from visloc_companion.config import Config
    from visloc_companion.doctor.examine import Report


def doctor(
    link: Annotated[
        str, typer.Option("--link", metavar="URL", help="The autopilot: serial:DEVICE:BAUD, udpin:HOST:PORT, ... (link.url).")
    ] = "",
    config: Annotated[Path | None, typer.Option("--config", help="The daemon's configuration: camera, map, network too.")] = None,
    fix: Annotated[
        Path | None, typer.Option("--fix", metavar="FILE.param", help="Write a parameter file with only what must change.")
    ] = None,
    apply: Annotated[bool, typer.Option("--apply", help="Also set it in the autopilot, read back; refused while armed.")] = False,
    json: Annotated[Path | None, typer.Option("--json", help="Write the result as JSON.")] = None,
    seconds: Annotated[float, typer.Option("--seconds", min=1.0, max=120.0, help="How long rates and time are measured.")] = 5.0,
    wait: Annotated[float, typer.Option("--wait", min=1.0, max=3600.0, help="Time to wait for the autopilot, seconds.")] = 10.0,
    everything: Annotated[bool, typer.Option("--all", help="Show skipped rules, too.")] = False,
) -> None:
    """Judge autopilot, link, camera, map and computer. Exit codes: 0 ok, 1 a rule is red, 2 usage or configuration, 4 link."""
    import asyncio

    from visloc_companion.cli.progress import require_folder
    from visloc_companion.config import load_config
    from visloc_companion.doctor.examine import Wishes, examine
    from visloc_companion.errors import ConfigError

    settings = None if config is None else load_config(config)
    url = link or (settings.link.url if settings is not None else "")
    if not url:
        raise ConfigError("neither --link nor --config is given", where="doctor", remedy="name the autopilot's link, --link URL")
    require_folder(fix, "--fix", config)
    require_folder(json, "--json", config, fix)
    told = _with_link(settings, url)
    report = asyncio.run(examine(Wishes(url, told, seconds, wait, apply)))
    try:
        _print(report, everything)
    finally:  # a reader of the table that went away must not cost the files
        _write(report, fix, json)
    if fix is not None and not report.facts.parameters:
        typer.echo(f"{fix} is not written: no parameter of the autopilot was read", err=True)
    if report.problem is not None:
        raise report.problem
    from visloc_companion.doctor.report import is_red

    raise typer.Exit(1 if is_red(report) else 0)


def _with_link(settings: Config | None, url: str) -> Config | None:
    """The configuration with the link that is really asked: its rules speak of that one."""
    if settings is None:
        return None
    return settings.model_copy(update={"link": settings.link.model_copy(update={"url": url})})


def _print(report: Report, everything: bool) -> None:
    from rich.console import Console

    from visloc_companion.doctor.finding import number
    from visloc_companion.doctor.parameter_file import diff
    from visloc_companion.doctor.report import NARROW, listed, summary, table

    console = Console(soft_wrap=False)
    if console.width < NARROW:
        for answer in listed(report, everything):
            console.print(answer)
    else:
        console.print(table(report, everything))
    if report.changes:
        console.print("To change in the autopilot:", highlight=False)
        for line in diff(report.facts.parameters, report.changes):
            console.print(f"  {line}", highlight=False, markup=False)
    for name, value in report.applied.items():
        console.print(f"set and read back: {name} = {number(value)}", highlight=False, markup=False)
    if report.changes:
        done = "The table is of before. " if report.applied else ""
        console.print(f"{done}Afterwards reboot the autopilot, and run the doctor again.", highlight=False)
    console.print(summary(report), highlight=False)


def _write(report: Report, fix: Path | None, json_path: Path | None) -> None:
    from visloc_companion.cli.progress import write_json, write_text
    from visloc_companion.doctor.parameter_file import render
    from visloc_companion.doctor.report import as_json

    if json_path is not None:
        write_json(json_path, as_json(report))
    if fix is not None and report.facts.parameters:
        system_id = 1 if report.facts.link is None else report.facts.link.system_id
        write_text(fix, render(report.facts.autopilot, report.changes, system_id, report.types), "--fix")
