"""The rows of benchmarks/autopilots.py as a table in Markdown."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from visloc_companion.sim.real.programs import Simulator
from visloc_companion.sim.real.scenarios import NAMES, SEEN

Row = dict[str, Any]
DOCS = Path(__file__).resolve().parents[2] / "docs" / "autopilots.md"
ROWS = DOCS.parent / "reports" / "autopilots"
BEGIN, END = "<!-- table of benchmarks.autopilots: begin -->", "<!-- end -->"
TOO_FAR = 1 / 3
HEADER = (
    "| autopilot | flight | odometry | on vision s | 95 % m | largest m | on GNSS 95 % m | velocity rms m/s | rejected | "
    "failsafes in the air | wrong source s | pulled m | longest silence s | at the new place after s | built-in 95 % m | "
    "kept | commit |"
)
CALLED = {
    Simulator.ARDUCOPTER: "ArduCopter",
    Simulator.ARDUPLANE: "ArduPlane",
    Simulator.PX4: "PX4 quadrotor",
    Simulator.PX4_PLANE: "PX4 plane",
}


def row_path(folder: Path, simulator: Simulator, flight: str, seed: int) -> Path:
    """Where a row is kept."""
    return folder / f"{simulator}-{flight}-{seed}.json"


def read_rows(folder: Path) -> list[Row]:
    """All rows of a folder, by simulator and flight in the order of their lists."""
    rows: list[Row] = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*.json"))]
    simulators, flights = list(map(str, Simulator)), list(NAMES)
    known = [row for row in rows if row["simulator"] in simulators and row["flight"] in flights]
    return sorted(known, key=lambda row: (simulators.index(row["simulator"]), flights.index(row["flight"]), row["seed"]))


def table(rows: list[Row]) -> str:
    """The table, with a line of the programs' versions. A built-in figure more than a third off is bold."""
    lines = [HEADER, "|" + "---|" * (HEADER.count("|") - 1), *map(_line, rows)]
    versions = sorted({f"{CALLED[Simulator(row['simulator'])]}: {row['version']}" for row in rows if row.get("version")})
    return "\n".join([*lines, "", f"Programs: {'; '.join(versions)}."])


def written(page: str, rows: list[Row]) -> str:
    """A page with the table between its two marks. Raises ValueError for a page without them."""
    before, after = page.index(BEGIN) + len(BEGIN), page.index(END)
    return f"{page[:before]}\n{table(rows)}\n{page[after:]}"


def _line(row: Row) -> str:
    called = CALLED[Simulator(row["simulator"])]
    if "error" in row:
        why = " ".join(row["error"].split())
        return f"| {called} | `{row['flight']}` | not flown: {why} |" + " |" * (HEADER.count("|") - 4)
    cells = (
        called,
        f"`{row['flight']}`",
        _odometry(row),
        _number(row["vision_s"], 0),
        _number(row["error_p95_m"]),
        _number(row["error_max_m"] if row["judged"] else row.get("strayed_m")),
        _number(row["gnss_p95_m"]),
        _number(row["velocity_rms_mps"], 2),
        "" if row["rejected_share"] is None else f"{row['rejected_share']:.1%}",
        "; ".join(row["failsafes"]) or "none",
        _number(row["wrong_source_s"], 0),
        _number(row["pulled_m"]),
        _number(row["gap_s"]),
        _number(row["settled_s"]),
        _built_in(row["built_in_p95_m"], row["error_p95_m"]),
        "" if not row["judged"] else "**no**" if row["missed"] else "yes",
        row["commit"],
    )
    return f"| {' | '.join(cells)} |"


def _odometry(row: Row) -> str:
    """Whether its answers brought the camera's motion; rows of before that was said did with rendered frames only."""
    if not row["judged"]:
        return ""
    return "yes" if row.get("odometry", row["flight"] in SEEN) else "no"


def _built_in(built_in_m: float | None, real_m: float | None) -> str:
    shown = _number(built_in_m)
    far = built_in_m is not None and real_m is not None and abs(built_in_m / real_m - 1) > TOO_FAR
    return f"**{shown}**" if far else shown


def _number(value: float | None, digits: int = 1) -> str:
    if value is None:
        return ""
    return "never" if math.isinf(value) else f"{value:.{digits}f}"
