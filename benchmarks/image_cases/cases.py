"""Cases for the benchmarks, made by the shared tool from the shared imagery beside the project."""

from __future__ import annotations

import csv
import importlib.util
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

PROJECT = Path(__file__).resolve().parents[2]
SHARED = PROJECT.parent / "shared"
MAKER = SHARED / "tools" / "make_image_cases.py"
TRAINING_ROWS, TEST_ROWS = ":400", "400:"


@dataclass(frozen=True, slots=True)
class CaseSet:
    """One run of the tool: a kind, how many, the footprint in map pixels and whatever else it is told."""

    name: str
    kind: str
    n: int
    rows: str
    seed: int
    dates: str = "naip"
    foot: float = 173
    elsewhere: str = ""


def make(case_set: CaseSet, root: Path) -> Path:
    """The folder of a case set, made where it is not there yet."""
    folder = root / case_set.name
    if (folder / "cases.csv").exists():
        return folder
    dates = SHARED / "data" / case_set.dates
    command = [sys.executable, str(_maker_file()), str(dates), str(folder), "--kind", case_set.kind, "--n", str(case_set.n)]
    command += ["--seed", str(case_set.seed), "--foot", str(case_set.foot), "--rows", case_set.rows]
    if case_set.elsewhere:
        command += ["--elsewhere", str(SHARED / "data" / case_set.elsewhere)]
    subprocess.run(command, check=True)
    return folder


@cache
def maker() -> ModuleType:
    """The shared tool as a module: its `render`, `read`, `pix_per_metre`, `R_ned_frd` and constants."""
    spec = importlib.util.spec_from_file_location("make_image_cases", _maker_file())
    if spec is None or spec.loader is None:
        raise SystemExit(f"{MAKER} cannot be imported")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def write_tables(folder: Path, cases: Sequence[Mapping[str, Any]], truths: Sequence[Mapping[str, Any]]) -> Path:
    """Write `truth.csv`, then `cases.csv` (whose presence says that the folder is complete); returns the folder."""
    for file, table in (("truth.csv", truths), ("cases.csv", cases)):
        with (folder / file).open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, list(table[0]))
            writer.writeheader()
            writer.writerows(table)
    return folder


def read_table(path: Path) -> list[dict[str, Any]]:
    """Rows of a CSV, all fields as text."""
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def _maker_file() -> Path:
    if not MAKER.exists():
        raise SystemExit(f"{MAKER} is missing: the benchmarks need the shared folder beside the project")
    return MAKER
