"""Case folders of frames beside lines that have moved since the map was made (`benchmarks.moved_lines`), at several map pixels.

The frames are those of moved_lines, 105 to 135 m above procedural land; what differs is how finely the map shows it. Worlds below
100 are for fitting.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.image_cases.cases import case_row, euler_deg, truth_row, write_tables
from benchmarks.moved_lines import GSD_M, LANDS, MODEL, SIZE_M, frames, grown, line_of, mapped, over_moved
from visloc_companion.sim.landscape import build_landscape
from visloc_companion.sim.scene import Scene
from visloc_companion.types import PosePrior

SHARES = (0.33, 0.5, 0.67, 0.85)
"""Of the frame beyond the line; two frames each."""


@dataclass(frozen=True, slots=True)
class Moved:
    """Which worlds, and where their lines are in the frames: each world has one of the kinds, one of the map's pixels (metres, a
    whole multiple of GSD_M) and, by turns, land as it grows or land that was ploughed."""

    seeds: tuple[int, ...]
    kinds: tuple[str, ...]
    moved_m: tuple[float, ...]
    gsds_m: tuple[float, ...]
    shares: tuple[float, ...] = SHARES


def write_moved(folder: Path, moved: Moved) -> Path:
    """Write the cases, or keep a folder that is complete; seed after seed, each world's map beside the cases."""
    if (folder / "cases.csv").exists():
        return folder
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    cases: list[dict[str, Any]] = []
    truths: list[dict[str, Any]] = []
    for number, seed in enumerate(moved.seeds):
        kind, gsd_m = moved.kinds[number % len(moved.kinds)], moved.gsds_m[number % len(moved.gsds_m)]
        land = tuple(LANDS)[number % len(LANDS)]
        earlier, later = (build_landscape(seed, date, SIZE_M, GSD_M) for date in ("map", "flight"))
        line = line_of(seed, earlier)
        drawn = coarser(mapped(earlier, line, kind, seed), round(gsd_m / GSD_M)).save(folder / f"world{seed}")
        now = grown(later, land, seed)
        for moved_m in moved.moved_m:
            camera = over_moved(now, line, kind, moved_m, seed)
            for k, (_, place, attitude, pixels, request) in enumerate(frames(earlier, camera, line, seed, list(moved.shares))):
                name = f"{kind}{seed}_{moved_m:g}_{k:03d}"
                cv2.imwrite(str(folder / "frames" / f"{name}.png"), pixels[..., ::-1])
                prior = request.prior
                cases.append(case_row(name, drawn, MODEL, prior.place, euler_deg(prior.q_ned_frd), _sigmas(prior)))
                truths.append(truth_row(name, place, euler_deg(attitude), gsd_m, land))
    return write_tables(folder, cases, truths)


def coarser(scene: Scene, times: int) -> Scene:
    """A scene with pixels that are so many times as wide, each the mean of those in it."""
    width, height = (side // times for side in scene.size_px)

    def mean(plane: Any) -> Any:
        return cv2.resize(plane[: height * times, : width * times], (width, height), interpolation=cv2.INTER_AREA)

    from_coarse = np.array([[times, 0.0, (times - 1) / 2], [0.0, times, (times - 1) / 2], [0.0, 0.0, 1.0]])
    return Scene(mean(scene.pixels), mean(scene.dsm_amsl_m), scene.T_map_pix @ from_coarse, scene.crs)


def _sigmas(prior: PosePrior) -> dict[str, float]:
    return {
        **{"sigma_horizontal_m": math.sqrt(prior.cov_ne_m2[0][0]), "sigma_h_m": prior.sigma_h_m},
        **{"sigma_yaw_deg": math.degrees(prior.sigma_yaw_rad), "sigma_tilt_deg": math.degrees(prior.sigma_tilt_rad)},
    }
