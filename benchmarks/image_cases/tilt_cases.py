"""Cases whose tilt the prior does not know, made of others: the prior says nadir and a sigma that holds the truth.

`without_surface` also takes the surface model away: a common real case is a map without one over ground with roofs and trees.
Heights then count from the mean surface under the frame, as they do where a barometer and a picture of the place are all that
there is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rasterio

from benchmarks.image_cases.cases import read_table, write_tables
from visloc_companion.geo.raster import T_map_pix_from_gdal, apply_affine, invert_affine
from visloc_companion.maps.crs import map_crs

SIGMA_TILT_DEG = 6.0
NADIR = {"prior_roll_deg": 0.0, "prior_pitch_deg": 0.0, "sigma_tilt_deg": SIGMA_TILT_DEG}
FOOTPRINT_HEIGHTS = 2 * math.tan(math.radians(30))
"""Side of the shared tool's footprint over the height above the ground."""


def untold(
    source: Path,
    folder: Path,
    *,
    largest_deg: float,
    n: int,
    without_surface: bool = False,
    prior: Mapping[str, float] = NADIR,
) -> Path:
    """The first `n` cases of a folder that tilt by no more than `largest_deg`, with a prior that says nadir or something else."""
    if (folder / "cases.csv").exists():
        return folder
    cases: list[dict[str, Any]] = []
    truths: list[dict[str, Any]] = []
    for told, truth in zip(read_table(source / "cases.csv"), read_table(source / "truth.csv"), strict=True):
        if len(cases) == n or tilt_deg(truth) > largest_deg:
            continue
        case = _found_from_anywhere(told, source) | dict(prior)
        found = _on_a_plane(case, truth) if without_surface else (case, truth)
        cases.append(found[0])
        truths.append(found[1])
    folder.mkdir(parents=True, exist_ok=True)
    return write_tables(folder, cases, truths)


def without_model(source: Path, folder: Path) -> Path:
    """The cases of a folder without their surface models."""
    if (folder / "cases.csv").exists():
        return folder
    pairs = zip(read_table(source / "cases.csv"), read_table(source / "truth.csv"), strict=True)
    cases, truths = zip(*(_on_a_plane(_found_from_anywhere(case, source), truth) for case, truth in pairs), strict=True)
    folder.mkdir(parents=True, exist_ok=True)
    return write_tables(folder, cases, truths)


def tilt_deg(truth: Mapping[str, Any]) -> float:
    """Angle between the camera's down axis and the vertical."""
    roll, pitch = (math.radians(float(truth[k])) for k in ("roll_deg", "pitch_deg"))
    return math.degrees(math.acos(math.cos(roll) * math.cos(pitch)))


def _found_from_anywhere(case: dict[str, Any], source: Path) -> dict[str, Any]:
    return case | {"frame": str((source / case["frame"]).resolve())}


def _on_a_plane(case: dict[str, Any], truth: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """A case without its surface model, with heights above the mean surface under the frame."""
    with rasterio.open(case["dsm"]) as source:
        surface, T_map_pix = source.read(1), T_map_pix_from_gdal(tuple(source.transform)[:6])
        at = map_crs(source.crs.to_string()).to_map(float(truth["lat_deg"]), float(truth["lon_deg"]))
    col, row = (round(float(x)) for x in apply_affine(invert_affine(T_map_pix), np.array(at)))
    above_m = float(truth["h_m"]) - float(surface[row, col])
    half = int(above_m * FOOTPRINT_HEIGHTS / 2 / float(T_map_pix[0, 0]))
    plane_m = float(surface[max(0, row - half) : row + half, max(0, col - half) : col + half].mean())
    lowered = case | {"dsm": "", "prior_h_m": float(case["prior_h_m"]) - plane_m}
    return lowered, truth | {"h_m": float(truth["h_m"]) - plane_m}
