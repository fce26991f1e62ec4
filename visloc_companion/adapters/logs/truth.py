"""truth.csv: where the vehicle really was, as somebody measured it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from visloc_companion.adapters.logs.recording import NS_PER_US
from visloc_companion.adapters.table import finer, number_in, read_table, refuse
from visloc_companion.types import GeoPoint

_COLUMNS = ("t_us", "lat_deg", "lon_deg", "h_amsl_m")
_LIMITS = {"t_us": 1e18, "lat_deg": 90.0, "lon_deg": 180.0, "h_amsl_m": 1e5}


@dataclass(frozen=True, slots=True)
class TruthRow:
    """Where the vehicle really was, on the recording's clock."""

    t_ns: int
    place: GeoPoint


def read_truth(path: Path, boot_from_file_ns: int) -> list[TruthRow]:
    """Rows of truth.csv in time order, what is there twice once; empty where there is no such file.

    Raises LogError naming the row and the column, and for two places at one time.
    """
    if not path.exists():
        return []
    found: dict[int, tuple[int, TruthRow]] = {}
    for number, values in enumerate(read_table(path, _COLUMNS), start=1):
        row = _row(path, number, values, boot_from_file_ns)
        first, known = found.setdefault(row.t_ns, (number, row))
        if known != row:
            what = f"has the time of row {first} and another place"
            raise refuse(path, number, "t_us", what, f"{finer(values['t_us'])}, or leave one of the places out")
    return sorted((row for _, row in found.values()), key=lambda row: row.t_ns)


def _row(path: Path, number: int, row: dict[str, str], boot_from_file_ns: int) -> TruthRow:
    t_us, lat_deg, lon_deg, h_amsl_m = (_value(path, number, row, name) for name in _COLUMNS)
    if lat_deg == lon_deg == 0:
        raise refuse(path, number, "lat_deg", "0, 0 is what receivers write without a fix", "leave out rows without a fix")
    return TruthRow(round(t_us) * NS_PER_US + boot_from_file_ns, GeoPoint(lat_deg, lon_deg, h_amsl_m))


def _value(path: Path, number: int, row: dict[str, str], name: str) -> float:
    try:
        value = number_in(row[name])
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise refuse(path, number, name, f"is missing or no number: {row[name][:40]!r}", "leave out rows without a measurement")
    if abs(value) > _LIMITS[name]:
        remedy = "write microseconds, degrees and metres"
        if name == "lat_deg" and abs(value) <= _LIMITS["lon_deg"]:
            remedy = "write latitudes in degrees; longitudes have a column of their own"
        raise refuse(path, number, name, f"{value:g} is beyond ±{_LIMITS[name]:g}", remedy)
    return value
