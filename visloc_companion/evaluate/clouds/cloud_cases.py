"""Folders of cloud cases: `cases.json` and, where there is one, `truth.json` (format: docs/structure.md)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from visloc_companion.errors import CasesError
from visloc_companion.evaluate.case_ids import require_distinct
from visloc_companion.evaluate.cases import LARGEST
from visloc_companion.evaluate.keys_once import loads_keys_once
from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.types import FloatArray

CLOUD_FIELDS = ("source", "reference")
LEAST_SIGMAS = {
    "sigma_horizontal_m": 0.1,
    "sigma_vertical_m": 0.1,
    "sigma_yaw_deg": 0.05,
    "sigma_tilt_deg": 0.02,
    "sigma_scale": 5e-4,
}
"""A prior is taken to know nothing better: what is given as exact (0) is to be found as well as a registration can tell, and an
answer that differs by a hair is no contradiction."""
SIGMA_FIELDS = tuple(LEAST_SIGMAS)
TRUTH_FIELDS = ("id", "T_reference_source")
ROUNDED = 5e-3
"""A truth with numbers of three decimals is a similarity to this."""
GROWTH = "sigma_growth_m"
"""A field that may be missing."""
GivenId = str | int | float
"""An id as `cases.json` has it: whoever joins the results on it must find it as it was."""


@dataclass(frozen=True, slots=True)
class CloudCase:
    """One cloud to be placed in another, the prior about the identity."""

    case_id: str
    source: Path
    reference: Path
    prior: RegistrationPrior
    given_id: GivenId


@dataclass(frozen=True, slots=True)
class BadCloudCase:
    """An entry that cannot be understood."""

    case_id: str
    why: str
    given_id: GivenId


def read_cloud_cases(folder: Path) -> list[CloudCase | BadCloudCase]:
    """The entries of `cases.json`. Raises CasesError where the file is missing or no list, or ids are not distinct."""
    path = folder / "cases.json"
    cases = [_case(folder, entry, k) for k, entry in enumerate(_entries(path))]
    require_distinct([case.case_id for case in cases], path)
    return cases


def read_by(folder: Path) -> set[Path]:
    """The clouds that cases read. Raises CasesError as `read_cloud_cases`."""
    return {file for case in read_cloud_cases(folder) if isinstance(case, CloudCase) for file in (case.source, case.reference)}


def read_cloud_truth(folder: Path) -> dict[str, FloatArray]:
    """T_reference_source (4, 4) by case id; empty where there is no `truth.json`. Raises CasesError for one that is none."""
    path = folder / "truth.json"
    if not path.exists():
        return {}
    truth: dict[str, FloatArray] = {}
    for number, entry in enumerate(_entries(path)):
        where = f"{path}: entry {number + 1}"
        if not isinstance(entry, dict) or any(field not in entry for field in TRUTH_FIELDS):
            raise CasesError(f"needs {' and '.join(TRUTH_FIELDS)}", where=where, remedy="add them")
        if (case_id := str(entry["id"])) in truth:
            raise CasesError(f"id {case_id!r} is there twice", where=where, remedy="write one entry a case")
        truth[case_id] = _similarity(entry["T_reference_source"], where)
    return truth


def _entries(path: Path) -> list[Any]:
    try:
        entries = loads_keys_once(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError) as why:
        raise CasesError(f"cannot be read: {why}", where=str(path), remedy="name a folder with cases.json") from why
    if not isinstance(entries, list):
        raise CasesError("is no list of cases", where=str(path), remedy="write a list of objects, one for each case")
    return entries


def _case(folder: Path, entry: object, number: int) -> CloudCase | BadCloudCase:
    if not isinstance(entry, dict):
        return BadCloudCase(f"entry{number + 1}", "is no object", f"entry{number + 1}")
    given_id = _given_id(entry, number)
    case_id = str(given_id)
    try:
        horizontal_m, vertical_m, yaw_deg, tilt_deg, scale = (
            max(_sigma(entry, field), least) for field, least in LEAST_SIGMAS.items()
        )
        growth_m = _sigma({GROWTH: 0.0} | entry, GROWTH)
        source, reference = (folder / _text(entry, field) for field in CLOUD_FIELDS)
    except ValueError as why:
        return BadCloudCase(case_id, str(why), given_id)
    angles = math.radians(yaw_deg), math.radians(tilt_deg)
    prior = RegistrationPrior(horizontal_m, vertical_m, *angles, scale, growth_m)
    return CloudCase(case_id, source, reference, prior, given_id)


def _given_id(entry: dict[str, Any], number: int) -> GivenId:
    given = entry.get("id")
    if given is None or given == "":
        return f"entry{number + 1}"
    as_it_is = isinstance(given, str | int) or (isinstance(given, float) and math.isfinite(given))
    return given if as_it_is else str(given)


def _sigma(entry: dict[str, Any], field: str) -> float:
    value = entry.get(field)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{field} is not a number: {value!r}")
    if not 0 <= value <= LARGEST:  # a JSON integer can be beyond any float
        raise ValueError(f"{field} is not a number from 0 to {LARGEST:g}: {str(value)[:20]}")
    return float(value)


def _text(entry: dict[str, Any], field: str) -> str:
    value = entry.get(field)
    if not isinstance(value, str) or not value or "\0" in value:
        raise ValueError(f"{field} names no file: {value!r}")
    return value


def _similarity(value: object, where: str) -> FloatArray:
    """(4, 4) with the last row 0 0 0 1, of a rotation and one scale: no mirror, no shear, no other scale of heights."""
    try:
        T = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as why:
        raise CasesError(f"T_reference_source: {why}", where=where, remedy="write 4 x 4 numbers, row by row") from why
    if T.shape != (4, 4) or not np.isfinite(T).all() or not np.array_equal(T[3], [0, 0, 0, 1]) or _bent(T[:3, :3]):
        raise CasesError("T_reference_source: is no similarity", where=where, remedy="write 4 x 4 numbers, row by row")
    return T


def _bent(linear: FloatArray) -> bool:
    """Whether (3, 3) is no rotation times a scale, to what rounded numbers may differ by."""
    with np.errstate(over="ignore", invalid="ignore"):
        scale = float(np.cbrt(np.linalg.det(linear)))
        return not scale > 0 or not float(np.abs(linear @ linear.T / scale**2 - np.eye(3)).max()) <= ROUNDED
