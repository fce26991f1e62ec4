"""`visloc run`: the daemon."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO, cast

import typer

if TYPE_CHECKING:
    from visloc_companion.app.first_position import At
    from visloc_companion.app.worker_ahead import WorkerAhead
    from visloc_companion.config import Config
    from visloc_companion.errors import VislocError

_WHOLE_LINES = 10_000
"""Columns: longer than any problem."""


def run(
    config: Annotated[Path, typer.Option("--config", help="Configuration (TOML), see docs/configuration.md.")],
    check: Annotated[bool, typer.Option("--check", help="Validate everything, print the effective configuration, end.")] = False,
    at: Annotated[
        str, typer.Option("--at", metavar="LAT,LON", help="Where the vehicle is, degrees; for starts without GNSS.")
    ] = "",
    sigma: Annotated[float, typer.Option("--sigma", help="How well that is known: 1-sigma radius in metres.")] = 50.0,
    json: Annotated[Path | None, typer.Option("--json", help="Write what --check found as JSON.")] = None,
) -> None:
    """Localise and inject until SIGTERM, SIGHUP or Ctrl-C. Exit codes: 0 ok, 2 configuration, 3 data, 4 link."""
    from visloc_companion.app.worker_ahead import ahead_for
    from visloc_companion.cli.ctrl_c import ends_at_once

    with ends_at_once():  # until the daemon listens for it
        ahead = None if check else ahead_for(config)  # before anything that takes long to import
        try:
            _run(config, check, at, sigma, json, ahead)
        finally:
            if ahead is not None:
                ahead.close()


def _run(config: Path, check: bool, at: str, sigma: float, json: Path | None, ahead: WorkerAhead | None) -> None:
    from visloc_companion.app.first_position import At
    from visloc_companion.cli.progress import require_folder
    from visloc_companion.config import load_config
    from visloc_companion.errors import ConfigError

    if json is not None and not check:
        raise ConfigError("is what --check found", where="--json", remedy="give it with --check")
    require_folder(json, "--json", config)
    settings = load_config(config)
    first = At.parsed(at, sigma) if at else None
    if check:
        _finish(_check(settings, json), config)
    with _logging():
        problems = _serve(settings, first, ahead)
    _finish(problems, config)


def _serve(config: Config, at: At | None, ahead: WorkerAhead | None = None) -> list[VislocError]:
    import asyncio
    import gc
    import signal

    from visloc_companion.app.live import run_daemon
    from visloc_companion.errors import VislocError

    async def serve() -> None:
        stop = asyncio.Event()
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):  # the last when the terminal that started it is gone
            if signal.getsignal(number) is not signal.SIG_IGN:  # nohup
                asyncio.get_running_loop().add_signal_handler(number, stop.set)
        gc.freeze()  # looking for garbage among all that was imported holds positions up in flight
        await run_daemon(config, stop=stop, at=at, ahead=ahead)

    problems: list[VislocError] = []
    try:
        asyncio.run(serve())
    except* VislocError as group:
        problems = _leaves(group)
    return problems


def _check(config: Config, json_path: Path | None) -> list[VislocError]:
    from visloc_companion.app.preflight import preflight
    from visloc_companion.cli.progress import write_json
    from visloc_companion.cli.toml import to_toml

    problems, found = preflight(config)
    sys.stdout.write(to_toml(config.model_dump(mode="json")))
    if json_path is not None:
        result = {
            "schema": 1,
            "configuration": config.model_dump(mode="json"),
            "found": found,
            "problems": [str(p) for p in problems],
        }
        write_json(json_path, result)
    return problems


def _leaves(group: BaseExceptionGroup[Any]) -> list[VislocError]:
    leaves: list[VislocError] = []
    for error in group.exceptions:
        leaves += _leaves(error) if isinstance(error, BaseExceptionGroup) else [error]
    return leaves


def _finish(problems: list[VislocError], config: Path) -> None:
    """Print the tree of problems, if there are any, and leave with the code of the gravest: 2, then 3, then 4."""
    if not problems:
        raise typer.Exit(0)
    from rich.console import Console
    from rich.text import Text
    from rich.tree import Tree

    from visloc_companion.cli.exit_code import exit_code

    tree = Tree(Text(f"visloc cannot run with {config}", style="bold red"))
    for problem in problems:
        branch = tree.add(Text(f"{problem.where}: {problem.what}" if problem.where else problem.what))
        if problem.remedy:
            branch.add(Text(f"remedy: {problem.remedy}", style="green"))
    # a tree is cut at the console's width where that is softly wrapped; into the journal each problem goes as one line
    Console(stderr=True, width=None if sys.stderr.isatty() else _WHOLE_LINES).print(tree)
    raise typer.Exit(min(exit_code(problem) for problem in problems))


@contextlib.contextmanager
def _logging() -> Iterator[None]:
    """Lines for people on a terminal, JSON lines for journald otherwise; always on stderr."""
    import structlog

    from visloc_companion.app.log_lines import LogLines

    terminal = sys.stderr.isatty()
    lines = LogLines(sys.stderr.fileno())
    structlog.configure(
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            structlog.dev.ConsoleRenderer() if terminal else structlog.processors.JSONRenderer(),
        ],
        logger_factory=structlog.WriteLoggerFactory(cast(TextIO, lines)),
        cache_logger_on_first_use=True,
    )
    try:
        yield
    finally:
        lines.close()
