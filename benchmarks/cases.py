"""Cases for the benchmarks, made by the shared tool from the shared imagery beside the project."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]
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
    if not MAKER.exists():
        raise SystemExit(f"{MAKER} is missing: the benchmarks need the shared folder beside the project")
    dates = SHARED / "data" / case_set.dates
    command = [sys.executable, str(MAKER), str(dates), str(folder), "--kind", case_set.kind, "--n", str(case_set.n)]
    command += ["--seed", str(case_set.seed), "--foot", str(case_set.foot), "--rows", case_set.rows]
    if case_set.elsewhere:
        command += ["--elsewhere", str(SHARED / "data" / case_set.elsewhere)]
    subprocess.run(command, check=True)
    return folder
