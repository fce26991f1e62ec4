"""Progress on stderr (plain lines where it is no terminal), and results as JSON with finite numbers only."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from visloc_companion.errors import ConfigError
from visloc_companion.whole_file import is_stream, write_result

PLAIN_STEPS = 10
RESULTS = (".json", ".html")
"""What stands in a folder under such a name is of a run before, and may be replaced, unless it is named itself."""
UNNAMEABLE = "backslashreplace"
"""What becomes of bytes in a file's name that are no UTF-8: as the escape that JSON reads, never the end of an hour's work."""


@contextmanager
def bar(what: str, total: float) -> Iterator[Callable[[float], None]]:
    """A progress bar; call with how much is done."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _plain(console, what, total)
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task(escape(what), total=total)
        yield lambda done: progress.update(task, completed=done)


def _plain(console: Console, what: str, total: float) -> Callable[[float], None]:
    told = 0

    def advance(done: float) -> None:
        nonlocal told
        share = done / total if total > 0 else 1.0
        steps = int(share * PLAIN_STEPS + 1e-9)
        if steps > told:
            told = steps
            console.print(f"{what}: {share:.0%}", highlight=False, markup=False)

    return advance


@contextmanager
def spinner(what: str) -> Iterator[Callable[[str], None]]:
    """A line that says what goes on; call with the stage."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda stage: console.print(f"{what}: {stage}", highlight=False, markup=False, soft_wrap=True)
        return
    with console.status(escape(what)) as status:
        yield lambda stage: status.update(escape(f"{what}: {stage}"))


def require_folder(path: Path | None, option: str, *others: Path | None) -> None:
    """Find out before long work that its result could not be written, or would replace one of the `others`: what the command
    reads, or writes besides; of a folder everything in it that is no result (`RESULTS`). Raises ConfigError naming the option."""
    if path is None:
        return
    try:
        with suppress(FileNotFoundError, NotADirectoryError):
            path.stat()  # from Python 3.14 on Path.exists() says False of what may not be looked at
        _require_folder(path, option, others)
    except OSError as why:
        raise ConfigError(
            f"cannot be written: {why.strerror}", where=str(path), remedy=f"name a writable file for {option}"
        ) from why


def _require_folder(path: Path, option: str, others: tuple[Path | None, ...]) -> None:
    if not path.parent.is_dir():
        raise ConfigError("its folder does not exist", where=str(path), remedy=f"name a file in an existing folder for {option}")
    if path.is_dir():
        raise ConfigError("is a folder", where=str(path), remedy=f"name a file for {option}")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise ConfigError("may not be written", where=str(path), remedy=f"name a writable file for {option}")
    if any(other is not None and _is_same(path, other) for other in others):
        raise ConfigError("is named twice, and would be overwritten", where=str(path), remedy=f"name another file for {option}")
    if any(other is not None and _is_part_of(path, other) for other in others):
        what = "is part of what is read, and would be overwritten"
        raise ConfigError(what, where=str(path), remedy=f"name another file for {option}")


def _is_part_of(path: Path, folder: Path) -> bool:
    return path.suffix.lower() not in RESULTS and path.is_file() and folder.is_dir() and _real(path).is_relative_to(_real(folder))


def _is_same(path: Path, other: Path) -> bool:
    if is_stream(path):  # takes more than one
        return False
    return path.samefile(other) if path.exists() and other.exists() else _real(path) == _real(other)


def _real(path: Path) -> Path:
    """Where it leads to; links that lead in a circle, at which Path.resolve raises, stay as they are."""
    return Path(os.path.realpath(path))


@contextmanager
def results_into(folder: Path, option: str) -> Iterator[None]:
    """Makes the folder; raises ConfigError naming the option where it, or what is written into it meanwhile, cannot be."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(folder))
        yield
    except OSError as why:
        raise ConfigError(f"cannot be written: {why}", where=str(folder), remedy=f"name a writable folder for {option}") from why


def make_folder(folder: Path | None, option: str) -> None:
    """Make the folder of results before long work, and before a file in it is looked for. Raises as `results_into`."""
    if folder is not None:
        with results_into(folder, option):
            pass


@contextmanager
def result_to(path: Path, option: str) -> Iterator[None]:
    """Raises ConfigError naming the option where the file that is written meanwhile cannot be."""
    try:
        yield
    except OSError as why:
        raise ConfigError(f"cannot be written: {why}", where=str(path), remedy=f"name a writable file for {option}") from why


def write_json(path: Path, result: dict[str, Any]) -> None:
    """Write UTF-8 JSON, whole or not at all. Raises ConfigError where the file cannot be written, ValueError for a number that is
    not finite."""
    text = json.dumps(result, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    write_text(path, text, "--json")


def write_text(path: Path, text: str, option: str) -> None:
    """Write a text in UTF-8, whole or not at all. Raises ConfigError naming the option where the file cannot be written."""
    with result_to(path, option):
        write_result(path, text.encode(errors=UNNAMEABLE))
