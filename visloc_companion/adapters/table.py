"""The tables beside frames and recorded flights (frames.csv, truth.csv): UTF-8 CSV whose first line names the columns."""

from __future__ import annotations

import csv
from pathlib import Path

from visloc_companion.errors import LogError, VislocError

ErrorKind = type[VislocError]
"""Of what is raised: a table of a recorded flight is a log, one of the daemon's camera a camera's."""


def read_table(path: Path, columns: tuple[str, ...], kind: ErrorKind = LogError) -> list[dict[str, str]]:
    """The rows by column, blanks about names and values left out; what a short row lacks is empty.

    Raises an error of `kind` for a file that cannot be read, lacks one of the columns or has it twice, or has no rows.
    """
    remedy = f"write UTF-8 CSV, separated by commas, with the columns {','.join(columns)}"
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            lines = [line for line in csv.reader(file, skipinitialspace=True) if any(value.strip() for value in line)]
    except (OSError, UnicodeDecodeError, csv.Error) as why:
        raise kind(f"cannot be read: {why}", where=str(path), remedy=remedy) from why
    names = [name.strip() for name in lines[0]] if lines else []
    if missing := [name for name in columns if name not in names]:
        raise kind(f"has no column {', '.join(missing)} (its first line is {','.join(names)!r})", where=str(path), remedy=remedy)
    if twice := [name for name in columns if names.count(name) > 1]:
        raise kind(f"has column {', '.join(twice)} more than once", where=str(path), remedy="leave one of them there")
    if len(lines) < 2:
        raise kind("has no rows", where=str(path), remedy=remedy)
    empty = dict.fromkeys(names, "")
    return [empty | dict(zip(names, (value.strip() for value in line), strict=False)) for line in lines[1:]]


def refuse(path: Path, number: int, column: str, what: str, remedy: str, kind: ErrorKind = LogError) -> VislocError:
    """The error about a value; `number` counts the rows from 1, without the line of names."""
    return kind(what, where=f"{path}, row {number}, column {column}", remedy=remedy)
