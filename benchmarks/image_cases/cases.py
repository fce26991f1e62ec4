"""Cases for the benchmarks, made by the shared tool from the shared imagery beside the project."""

from __future__ import annotations

import csv
import importlib.util
import math
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from visloc_companion.geo.se3 import euler_from_quat
from visloc_companion.types import CameraModel, GeoPoint, Quat, Vec3

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


def case_row(
    name: str, drawn: Sequence[Path], model: CameraModel, place: GeoPoint, attitude_deg: Vec3, sigmas: Mapping[str, float]
) -> dict[str, Any]:
    """One row of `cases.csv`: the map as drawn (orthophoto, surface), the prior's place and roll, pitch, yaw, and its sigmas by
    their columns."""
    roll, pitch, yaw = attitude_deg
    return {
        **{"id": name, "frame": f"frames/{name}.png", "ortho": str(drawn[0].resolve()), "dsm": str(drawn[1].resolve())},
        **{"fx_px": model.fx_px, "fy_px": model.fy_px, "cx_px": model.cx_px, "cy_px": model.cy_px},
        "distortion": " ".join(str(c) for c in model.distortion),
        **{"prior_lat_deg": place.lat_deg, "prior_lon_deg": place.lon_deg, "prior_h_m": place.h_amsl_m},
        **{"prior_roll_deg": roll, "prior_pitch_deg": pitch, "prior_yaw_deg": yaw % 360},
        **sigmas,
    }


def truth_row(name: str, place: GeoPoint, attitude_deg: Vec3, gsd_m: float, frame_date: str) -> dict[str, Any]:
    """One row of `truth.csv`, of a frame over a map of the landscape's earlier date."""
    roll, pitch, yaw = attitude_deg
    return {
        **{"id": name, "lat_deg": place.lat_deg, "lon_deg": place.lon_deg, "h_m": place.h_amsl_m},
        **{"roll_deg": roll, "pitch_deg": pitch, "yaw_deg": yaw, "gsd_m": gsd_m},
        **{"map_date": "map", "frame_date": frame_date, "solvable": 1},
    }


def euler_deg(q_ned_frd: Quat) -> Vec3:
    """Roll, pitch and yaw of an attitude, degrees."""
    roll, pitch, yaw = euler_from_quat(q_ned_frd)
    return math.degrees(roll), math.degrees(pitch), math.degrees(yaw)


def read_table(path: Path) -> list[dict[str, Any]]:
    """Rows of a CSV, all fields as text."""
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def _maker_file() -> Path:
    if not MAKER.exists():
        raise SystemExit(f"{MAKER} is missing: the benchmarks need the shared folder beside the project")
    return MAKER
