"""Case folders that the shared tool has no kind for: frames cut from one image and looked for on another.

All use the tool's camera (256 px, 60 degrees) and its `render`, so that the figures compare. Offsets are uniform, in map pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray

from benchmarks.image_cases.cases import maker, write_tables
from benchmarks.image_cases.shift import REACH_PX, shift_px
from visloc_companion.localise.features.gradient import gradient_features

MAX_TRIES = 2000


@dataclass(frozen=True, slots=True)
class Recipe:
    """What is drawn of a case: half ranges of the prior's offset (px), heading (deg), height (share), largest tilt (deg)."""

    offset_px: float = 40.0
    heading_deg: float = 10.0
    height: float = 0.08
    tilt_deg: float = 0.0


@dataclass(frozen=True, slots=True)
class Place:
    """One case before its prior is drawn: the frame (H, W, 3) RGB, the map, where the camera is on the map, and its pose."""

    frame: NDArray[Any]
    ortho: Path
    camera_pix: NDArray[np.float64]
    height_m: float
    attitude_deg: tuple[float, float, float]
    dates: tuple[str, str]
    foot_px: float
    solvable: bool


Draw = Callable[[np.random.Generator], "Place | None"]


def write_cases(folder: Path, n: int, seed: int, draw: Draw, recipe: Recipe) -> Path:
    """Draw until there are `n` cases and write them; a folder that is there already is kept. `draw` gives None to try again."""
    if (folder / "cases.csv").exists():
        return folder
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    cases, truths = [], []
    while len(cases) < n:
        place = next((drawn for _ in range(MAX_TRIES) if (drawn := draw(rng)) is not None), None)
        if place is None:
            raise SystemExit(f"{folder.name}: no place for a case in {MAX_TRIES} draws")
        case, truth = case_rows(f"{folder.name}{len(cases):04d}", place, recipe, rng)
        write_frame(folder / case["frame"], place.frame, rng)
        cases.append(case)
        truths.append(truth)
    return write_tables(folder, cases, truths)


def write_frame(file: Path, frame: NDArray[Any], rng: np.random.Generator) -> None:
    """Write a frame (H, W, 3) RGB as a camera takes it: brighter or darker, with noise, as the shared tool has it."""
    noisy = np.clip(frame * rng.uniform(0.8, 1.2) + rng.normal(0, 3, frame.shape), 0, 255).astype(np.uint8)
    cv2.imwrite(str(file), noisy[..., ::-1])


def nominal_height_m(foot_px: float, gsd_m: float) -> float:
    """Height above the ground from which the camera sees `foot_px` map pixels across."""
    return foot_px * gsd_m / 2 / math.tan(math.radians(30))


def two_dates(folders: list[Path], foot_px: float, recipe: Recipe) -> Draw:
    """Frames of one date on the map of another of the same folder, anywhere on it (both ways round).

    Dates may be apart by a few pixels, uniformly (README of the bi-temporal data): by how much is measured over the whole image,
    and the camera is put where it sees what the map shows at the case's place.
    """
    images = {folder: [(path, *maker().read(path)) for path in sorted(folder.glob("*.tif"))] for folder in folders}
    shifts: dict[tuple[Path, Path], NDArray[np.float64]] = {}

    def draw(rng: np.random.Generator) -> Place | None:
        dates = images[folders[rng.integers(len(folders))]]
        a, b = rng.choice(len(dates), 2, replace=False)
        (frame_file, scene, _, _), (map_file, ortho, transform, crs) = dates[a], dates[b]
        if (frame_file, map_file) not in shifts:
            shifts[frame_file, map_file] = whole_shift_px(scene, ortho)
        at = anywhere(rng, ortho.shape, 0.62 * foot_px)
        seen_at, names = at - shifts[frame_file, map_file], (map_file.stem, frame_file.stem)
        return cut(rng, scene, seen_at, (map_file, transform, crs), at, recipe, foot_px, names, True)

    return draw


def whole_shift_px(scene: NDArray[Any], ortho: NDArray[Any]) -> NDArray[np.float64]:
    """(2,) columns and rows from where the scene shows something to where the map shows it; zero where undetermined."""
    side = min(scene.shape[:2]) - 2 * REACH_PX
    a, b = (gradient_features(image, np.ones(image.shape[:2], dtype=np.bool_)) for image in (scene, ortho))
    found = shift_px(a, b, (scene.shape[1] / 2, scene.shape[0] / 2), side)
    return np.zeros(2) if found is None else found


def anywhere(rng: np.random.Generator, shape: tuple[int, ...], margin: float) -> NDArray[np.float64]:
    """(2,) column and row, uniform, at least a margin away from the border."""
    return np.array([rng.uniform(margin, shape[1] - margin), rng.uniform(margin, shape[0] - margin)])


def cut(
    rng: np.random.Generator,
    scene: NDArray[Any],
    seen_at: NDArray[np.float64],
    on: tuple[Path, Any, Any],
    at: NDArray[np.float64],
    recipe: Recipe,
    foot_px: float,
    dates: tuple[str, str],
    solvable: bool,
) -> Place | None:
    """A frame of `scene` about `seen_at` that claims to be at `at` of the map; None where it leaves the scene."""
    tool, (map_file, transform, crs) = maker(), on
    lon, lat = lon_lat(transform, crs, at)
    height = nominal_height_m(foot_px, transform.a) * (1 + rng.uniform(-recipe.height, recipe.height))
    tilt, direction = rng.uniform(0, recipe.tilt_deg) if recipe.tilt_deg else 0.0, rng.uniform(0, 2 * math.pi)
    roll, pitch, yaw = tilt * math.sin(direction), tilt * math.cos(direction), float(rng.uniform(0, 360))
    frame, coverage = tool.render(
        scene, seen_at, tool.pix_per_metre(transform, crs, lat, lon), height, tool.R_ned_frd(yaw, pitch, roll)
    )
    if coverage < (0.7 if recipe.tilt_deg else 0.97):
        return None
    return Place(frame, map_file, at, height, (roll, pitch, yaw), dates, foot_px, solvable)


def case_rows(name: str, place: Place, recipe: Recipe, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    tool = maker()
    transform, crs = georeference(place.ortho)
    lon, lat = lon_lat(transform, crs, place.camera_pix)
    gsd_m = transform.a
    north, east = rng.uniform(-recipe.offset_px, recipe.offset_px, 2) * gsd_m
    prior_lon, prior_lat, _ = tool.GEOD.fwd(lon, lat, math.degrees(math.atan2(east, north)), math.hypot(north, east))
    roll, pitch, yaw = place.attitude_deg
    sigma_tilt = 0.3 if recipe.tilt_deg else 0.01
    nominal = nominal_height_m(place.foot_px, gsd_m)
    case = {
        **{"id": name, "frame": f"frames/{name}.png", "ortho": str(place.ortho.resolve()), "dsm": "", "distortion": ""},
        **{"fx_px": tool.FOCAL_PX, "fy_px": tool.FOCAL_PX, "cx_px": tool.CENTRE_PX, "cy_px": tool.CENTRE_PX},
        **{"prior_lat_deg": prior_lat, "prior_lon_deg": prior_lon, "prior_h_m": nominal},
        "prior_roll_deg": roll + rng.normal(0, sigma_tilt),
        "prior_pitch_deg": pitch + rng.normal(0, sigma_tilt),
        "prior_yaw_deg": (yaw + rng.uniform(-recipe.heading_deg, recipe.heading_deg)) % 360,
        "sigma_horizontal_m": recipe.offset_px * gsd_m / 3**0.5,
        "sigma_h_m": recipe.height * nominal / 3**0.5,
        "sigma_yaw_deg": recipe.heading_deg / 3**0.5,
        "sigma_tilt_deg": sigma_tilt,
    }
    truth = {
        **{
            "id": name,
            "lat_deg": lat,
            "lon_deg": lon,
            "h_m": place.height_m,
            "roll_deg": roll,
            "pitch_deg": pitch,
            "yaw_deg": yaw,
        },
        **{"gsd_m": gsd_m, "map_date": place.dates[0], "frame_date": place.dates[1], "solvable": int(place.solvable)},
    }
    return case, truth


def georeference(path: Path) -> tuple[Any, Any]:
    """Transform and CRS of a raster."""
    with rasterio.open(path) as source:
        return source.transform, source.crs


def pix_of(georeferenced: tuple[Any, Any], lat_deg: float, lon_deg: float) -> tuple[float, float]:
    """`pix` (column, row) of a place on a raster of that transform and CRS."""
    transform, crs = georeferenced
    col, row = ~transform * maker().pyproj.Transformer.from_crs(4326, crs, always_xy=True).transform(lon_deg, lat_deg)
    return float(col) - 0.5, float(row) - 0.5


def lon_lat(transform: Any, crs: Any, pix: NDArray[np.float64]) -> tuple[float, float]:
    easting, northing = transform * tuple(pix + 0.5)
    lon, lat = maker().pyproj.Transformer.from_crs(crs, 4326, always_xy=True).transform(easting, northing)
    return float(lon), float(lat)
