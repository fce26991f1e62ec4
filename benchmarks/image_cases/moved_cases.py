"""Case folders of frames beside lines that have moved since the map was made (`benchmarks.moved_lines`), at several map pixels.

The frames are those of moved_lines, 105 to 135 m above procedural land; what differs is how finely the map shows it. Worlds below
100 are for fitting.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.image_cases.cases import write_tables
from benchmarks.moved_lines import GSD_M, LANDS, MODEL, SIZE_M, covered, frames, grown, line_of, mapped
from visloc_companion.geo.se3 import euler_from_quat
from visloc_companion.sim.landscape import build_landscape
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_effects import CameraEffects
from visloc_companion.sim.scene import Scene
from visloc_companion.types import GeoPoint, LocaliseRequest, Quat

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
            scene, water = covered(now, line, kind, moved_m, seed + 500)
            camera = CameraSimulator(scene, MODEL, CameraEffects(), water)
            for k, (_, place, attitude, pixels, request) in enumerate(frames(earlier, camera, line, seed, list(moved.shares))):
                name = f"{kind}{seed}_{moved_m:g}_{k:03d}"
                cv2.imwrite(str(folder / "frames" / f"{name}.png"), pixels[..., ::-1])
                cases.append(_case(name, drawn, request))
                truths.append(_truth(name, land, place, attitude, gsd_m))
    return write_tables(folder, cases, truths)


def coarser(scene: Scene, times: int) -> Scene:
    """A scene with pixels that are so many times as wide, each the mean of those in it."""
    width, height = (side // times for side in scene.size_px)

    def mean(plane: Any) -> Any:
        return cv2.resize(plane[: height * times, : width * times], (width, height), interpolation=cv2.INTER_AREA)

    from_coarse = np.array([[times, 0.0, (times - 1) / 2], [0.0, times, (times - 1) / 2], [0.0, 0.0, 1.0]])
    return Scene(mean(scene.pixels), mean(scene.dsm_amsl_m), scene.T_map_pix @ from_coarse, scene.crs)


def _case(name: str, drawn: Sequence[Path], request: LocaliseRequest) -> dict[str, Any]:
    prior = request.prior
    roll, pitch, yaw = (math.degrees(a) for a in euler_from_quat(prior.q_ned_frd))
    return {
        **{"id": name, "frame": f"frames/{name}.png", "ortho": str(drawn[0].resolve()), "dsm": str(drawn[1].resolve())},
        **{"fx_px": MODEL.fx_px, "fy_px": MODEL.fy_px, "cx_px": MODEL.cx_px, "cy_px": MODEL.cy_px, "distortion": ""},
        **{"prior_lat_deg": prior.place.lat_deg, "prior_lon_deg": prior.place.lon_deg, "prior_h_m": prior.place.h_amsl_m},
        **{"prior_roll_deg": roll, "prior_pitch_deg": pitch, "prior_yaw_deg": yaw % 360},
        **{"sigma_horizontal_m": math.sqrt(prior.cov_ne_m2[0][0]), "sigma_h_m": prior.sigma_h_m},
        **{"sigma_yaw_deg": math.degrees(prior.sigma_yaw_rad), "sigma_tilt_deg": math.degrees(prior.sigma_tilt_rad)},
    }


def _truth(name: str, land: str, place: GeoPoint, attitude: Quat, gsd_m: float) -> dict[str, Any]:
    roll, pitch, yaw = (math.degrees(a) for a in euler_from_quat(attitude))
    return {
        **{"id": name, "lat_deg": place.lat_deg, "lon_deg": place.lon_deg, "h_m": place.h_amsl_m},
        **{"roll_deg": roll, "pitch_deg": pitch, "yaw_deg": yaw, "gsd_m": gsd_m},
        **{"map_date": "map", "frame_date": land, "solvable": 1},
    }
