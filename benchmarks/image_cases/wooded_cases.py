"""Case folders of cameras that lean over woods (every other view) and elsewhere: what `benchmarks.leaning` looks at, as cases.

Seeds below 100 are for fitting, the others for scoring only. Positions are judged in metres (`gsd_m` = 1): a wood places a frame
to a metre or three, whatever the map's pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.image_cases.cases import case_row, euler_deg, truth_row, write_tables
from benchmarks.landscape import MODEL
from benchmarks.leaning import DATES, GSD_M, SIZE_M, View, views
from visloc_companion.geo.se3 import quat_from_vector, quat_multiply
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.sim.land.landscape_grid import Grid
from visloc_companion.sim.land.landscape_plan import make_plan
from visloc_companion.sim.land.landscape_terrain import terrain
from visloc_companion.sim.landscape import build_landscape
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_effects import CameraEffects

LARGEST_DEG = 45.0
PLACE_M, HEIGHT_M, YAW_DEG, TILT_DEG = 4.0, 2.0, 2.0, 0.7
"""1-sigma of the prior: some seconds after the last fix."""


def write_wooded(folder: Path, seeds: tuple[int, ...], per_date: int) -> Path:
    """Write the cases, or keep a folder that is complete: so many views of each of three dates over each world."""
    if (folder / "cases.csv").exists():
        return folder
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    cases: list[dict[str, Any]] = []
    truths: list[dict[str, Any]] = []
    for seed in seeds:
        known = build_landscape(seed, "map", SIZE_M, GSD_M)
        drawn = known.save(folder / f"world{seed}")
        ground_m = terrain(seed, Grid(round(SIZE_M / GSD_M), GSD_M), make_plan(seed, SIZE_M))
        stands_m = np.asarray(known.dsm_amsl_m - ground_m, dtype=np.float32)
        for date, season in enumerate(DATES):
            scene = build_landscape(seed, season, SIZE_M, GSD_M)
            camera, rng = CameraSimulator(scene, MODEL, CameraEffects()), np.random.default_rng([seed, date, 7])
            for number, view in enumerate(views(scene, ground_m, stands_m, rng, per_date, LARGEST_DEG)):
                name = f"wood{seed}_{date}_{number:03d}"
                pixels = camera.frame(view[0], view[1], 1000 * seed + 100 * date + number)
                cv2.imwrite(str(folder / "frames" / f"{name}.png"), pixels[..., ::-1])
                cases.append(_case(name, drawn, rng, view))
                truths.append(truth_row(name, view[0], euler_deg(view[1]), 1.0, f"date {date}"))
    return write_tables(folder, cases, truths)


def _case(name: str, drawn: Sequence[Path], rng: np.random.Generator, view: View) -> dict[str, Any]:
    north, east, down = (rng.normal(0, 1, 3) * (PLACE_M, PLACE_M, HEIGHT_M)).tolist()
    turned = quat_from_vector(tuple(np.radians(rng.normal(0, 1, 3) * (TILT_DEG, TILT_DEG, YAW_DEG)).tolist()))
    place = geo_from_ned((north, east, down), view[0])
    sigmas = {"sigma_horizontal_m": PLACE_M, "sigma_h_m": HEIGHT_M, "sigma_yaw_deg": YAW_DEG, "sigma_tilt_deg": TILT_DEG}
    return case_row(name, drawn, MODEL, place, euler_deg(quat_multiply(turned, view[1])), sigmas)
