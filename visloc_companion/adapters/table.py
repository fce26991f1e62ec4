"""The tables beside frames and recorded flights (frames.csv, truth.csv): UTF-8 CSV whose first line names the columns."""

from __future__ import annotations

import csv
import io
from contextlib import suppress
from pathlib import Path

from visloc_companion.errors import LogError, VislocError

ErrorKind = type[VislocError]
"""Of what is raised: a table of a recorded flight is a log, one of the daemon's camera a camera's."""


def read_table(path: Path, columns: tuple[str, ...], kind: ErrorKind = LogError) -> list[dict[str, str]]:
    """The rows by column, blanks about names and values left out; what a short row lacks is empty.

    Raises an error of `kind` for a file that cannot be read, lacks one of the columns or has it twice, has no rows, or a row
    with more values than there are columns.
    """
    remedy = f"write UTF-8 CSV, separated by commas, with the columns {','.join(columns)}"
    try:
        lines, _ = _whole_lines(path)
    except (OSError, UnicodeDecodeError, csv.Error) as why:
        raise kind(f"cannot be read: {why}", where=str(path), remedy=remedy) from why
    names = [name.strip() for name in lines[0]] if lines else []
    if missing := [name for name in columns if name not in names]:
        raise kind(f"has no column {', '.join(missing)} (its first line is {','.join(names)!r})", where=str(path), remedy=remedy)
    if twice := [name for name in columns if names.count(name) > 1]:
        raise kind(f"has column {', '.join(twice)} more than once", where=str(path), remedy="leave one of them there")
    if len(lines) < 2:
        raise kind("has no rows", where=str(path), remedy=remedy)
    for number, line in enumerate(lines[1:], start=1):
        if beyond := [value.strip() for value in line[len(names) :] if value.strip()]:
            what = f"has more fields than there are columns ({', '.join(beyond)!r:.80})"
            how = "write decimals with a point, and texts with commas in quotes"
            raise kind(what, where=f"{path}, row {number}", remedy=how)
    empty = dict.fromkeys(names, "")
    return [empty | dict(zip(names, (value.strip() for value in line), strict=False)) for line in lines[1:]]


def number_in(text: str) -> float:
    """The number of a field. Raises ValueError where there is none; Python itself takes 1_0 for ten."""
    return float(text.replace("_", "no digit"))


def finer(t_us: str) -> str:
    """What to do about rows of one time, this being that of one of them: with a fraction it is of one microsecond with the other
    for being in seconds."""
    return "write finer times" if number_in(t_us).is_integer() else f"write microseconds ({t_us} looks like seconds)"


def torn(path: Path) -> list[str]:
    """A sentence on a table that ends in the middle of a row, as a loss of power leaves it; what is whole of it is read."""
    with suppress(OSError, UnicodeDecodeError, csv.Error):
        if _whole_lines(path)[1]:
            what = f"{path.name} ends in the middle of a row or in zeros, as a loss of power leaves it"
            return [f"{what}: the rows before were read."]
    return []


def _whole_lines(path: Path) -> tuple[list[list[str]], bool]:
    """Lines with anything in them by their values, and whether one more was cut off: it lacks its end, and values of the line
    before, or zeros follow it (blocks of a disk that was promised more)."""
    text = path.read_bytes().decode("utf-8-sig")
    whole = text.rstrip("\0")
    rows = csv.reader(io.StringIO(whole, newline=""), skipinitialspace=True)
    lines = [line for line in rows if any(value.strip() for value in line)]
    has_end = whole.endswith(("\n", "\r"))
    cut = not has_end and len(lines) > 2 and (whole != text or len(lines[-1]) < len(lines[-2]))
    return (lines[:-1] if cut else lines), cut or whole != text


def refuse(path: Path, number: int, column: str, what: str, remedy: str, kind: ErrorKind = LogError) -> VislocError:
    """The error about a value; `number` counts the rows from 1, without the line of names."""
    return kind(what, where=f"{path}, row {number}, column {column}", remedy=remedy)
