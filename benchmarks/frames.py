"""Case folders that the shared tool has no kind for: frames cut from one image and looked for on another, and negatives.

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
from rasterio.windows import Window

from benchmarks.cases import SHARED, maker, write_tables

NDWI_WATER = 0.15
"""Water is where (green - NIR) / (green + NIR) exceeds this (McFeeters 1996; lakes of all ten dates lie clearly above)."""


HALF_DIAGONAL = 0.77
"""Of a footprint of side 1 at the largest height drawn."""
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
        case, truth = _rows(f"{folder.name}{len(cases):04d}", place, recipe, rng)
        noisy = np.clip(place.frame * rng.uniform(0.8, 1.2) + rng.normal(0, 3, place.frame.shape), 0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / case["frame"]), noisy[..., ::-1])
        cases.append(case)
        truths.append(truth)
    return write_tables(folder, cases, truths)


def nominal_height_m(foot_px: float, gsd_m: float) -> float:
    """Height above the ground from which the camera sees `foot_px` map pixels across."""
    return foot_px * gsd_m / 2 / math.tan(math.radians(30))


def two_dates(folders: list[Path], foot_px: float, recipe: Recipe) -> Draw:
    """Frames of one date on the map of another of the same folder, anywhere on it (both ways round)."""
    images = {folder: [(path, *maker().read(path)) for path in sorted(folder.glob("*.tif"))] for folder in folders}

    def draw(rng: np.random.Generator) -> Place | None:
        dates = images[folders[rng.integers(len(folders))]]
        (frame_file, scene, _, _), (map_file, ortho, transform, crs) = (
            dates[k] for k in rng.choice(len(dates), 2, replace=False)
        )
        at = _anywhere(rng, ortho.shape, 0.62 * foot_px)
        return _cut(rng, scene, at, (map_file, transform, crs), at, recipe, foot_px, (map_file.stem, frame_file.stem), True)

    return draw


def water(foot_px: float, rows: tuple[int, int]) -> Draw:
    """NAIP frames that show nothing but lake, by the rule above, on both dates, however the footprint is turned."""
    files = sorted((SHARED / "data" / "naip").glob("*.tif"))
    images = [maker().read(path) for path in files]
    lakes = [_from_shore_px(_lake(path)) > HALF_DIAGONAL * foot_px for path in files]

    def draw(rng: np.random.Generator) -> Place | None:
        a, b = rng.choice(len(files), 2, replace=False)
        inside = np.argwhere((lakes[a] & lakes[b])[rows[0] : rows[1]])
        if not len(inside):
            return None
        row, col = inside[rng.integers(len(inside))]
        at = np.array([col, row + rows[0]], dtype=np.float64)
        _, transform, crs = images[b]
        dates = (files[b].stem, files[a].stem)
        return _cut(rng, images[a][0], at, (files[b], transform, crs), at, Recipe(), foot_px, dates, False)

    return draw


def outside(pack: Path, frame_rows: tuple[int, int], foot_px: float) -> Draw:
    """NAIP frames over ground that the map (one of the files in `pack`: other rows, or another place) does not hold."""
    files = sorted((SHARED / "data" / "naip").glob("*.tif"))
    scenes = [maker().read(path)[0] for path in files]
    maps = [(path, *maker().read(path)) for path in sorted(pack.glob("*.tif"))]
    margin = 0.62 * foot_px

    def draw(rng: np.random.Generator) -> Place | None:
        a, b = int(rng.integers(len(files))), int(rng.integers(len(maps)))
        map_file, ortho, transform, crs = maps[b]
        low, high = frame_rows[0] + margin, min(frame_rows[1], scenes[a].shape[0]) - margin
        seen_at = np.array([rng.uniform(margin, scenes[a].shape[1] - margin), rng.uniform(low, high)])
        at = _anywhere(rng, ortho.shape, margin)
        dates = (map_file.stem, files[a].stem)
        return _cut(rng, scenes[a], seen_at, (map_file, transform, crs), at, Recipe(), foot_px, dates, False)

    return draw


def clouds(rows: tuple[int, int], foot_px: float) -> Draw:
    """Frames of nothing but cloud: noise of a power law (exponent 1.2 to 2 in amplitude), bright, of little or much contrast."""
    files = sorted((SHARED / "data" / "naip").glob("*.tif"))
    images = [maker().read(path) for path in files]

    def draw(rng: np.random.Generator) -> Place:
        k = int(rng.integers(len(files)))
        ortho, transform, _ = images[k]
        margin = 0.62 * foot_px
        at = np.array([rng.uniform(margin, ortho.shape[1] - margin), rng.uniform(max(margin, rows[0]), rows[1] - margin)])
        height = nominal_height_m(foot_px, transform.a) * (1 + rng.uniform(-0.08, 0.08))
        attitude = (0.0, 0.0, float(rng.uniform(0, 360)))
        return Place(_cloud(rng), files[k], at, height, attitude, (files[k].stem, "cloud"), foot_px, False)

    return draw


def write_pack(folder: Path, rows: tuple[int, int]) -> Path:
    """The NAIP dates cut to some rows, as maps that end there."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in sorted((SHARED / "data" / "naip").glob("*.tif")):
        if (folder / path.name).exists():
            continue
        with rasterio.open(path) as source:
            window = Window(0, rows[0], source.width, rows[1] - rows[0])
            profile = source.profile | {"height": rows[1] - rows[0], "transform": source.window_transform(window)}
            with rasterio.open(folder / path.name, "w", **profile) as target:
                target.write(source.read(window=window))
    return folder


def _anywhere(rng: np.random.Generator, shape: tuple[int, ...], margin: float) -> NDArray[np.float64]:
    return np.array([rng.uniform(margin, shape[1] - margin), rng.uniform(margin, shape[0] - margin)])


def _cut(
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
    lon, lat = _lon_lat(transform, crs, at)
    height = nominal_height_m(foot_px, transform.a) * (1 + rng.uniform(-recipe.height, recipe.height))
    tilt, direction = rng.uniform(0, recipe.tilt_deg) if recipe.tilt_deg else 0.0, rng.uniform(0, 2 * math.pi)
    roll, pitch, yaw = tilt * math.sin(direction), tilt * math.cos(direction), float(rng.uniform(0, 360))
    frame, coverage = tool.render(
        scene, seen_at, tool.pix_per_metre(transform, crs, lat, lon), height, tool.R_ned_frd(yaw, pitch, roll)
    )
    if coverage < (0.7 if recipe.tilt_deg else 0.97):
        return None
    return Place(frame, map_file, at, height, (roll, pitch, yaw), dates, foot_px, solvable)


def _rows(name: str, place: Place, recipe: Recipe, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    tool = maker()
    transform, crs = georeference(place.ortho)
    lon, lat = _lon_lat(transform, crs, place.camera_pix)
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


def _lon_lat(transform: Any, crs: Any, pix: NDArray[np.float64]) -> tuple[float, float]:
    easting, northing = transform * tuple(pix + 0.5)
    lon, lat = maker().pyproj.Transformer.from_crs(crs, 4326, always_xy=True).transform(easting, northing)
    return float(lon), float(lat)


def _lake(path: Path) -> NDArray[np.bool_]:
    with rasterio.open(path) as source:
        green, near_infrared = (source.read(band).astype(np.float32) for band in (2, 4))
    return np.asarray((green - near_infrared) / (green + near_infrared + 1) > NDWI_WATER, dtype=np.bool_)


def _from_shore_px(lake: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Distance of every pixel of a lake from the nearest that is none, or from the image's border."""
    padded = np.pad(lake.astype(np.uint8), 1)
    return np.asarray(cv2.distanceTransform(padded, cv2.DIST_L2, 5)[1:-1, 1:-1], dtype=np.float32)


def _cloud(rng: np.random.Generator) -> NDArray[np.float64]:
    side = maker().FRAME_PX
    frequency = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None, :])
    frequency[0, 0] = 1.0
    spectrum = np.fft.rfft2(rng.normal(size=(side, side))) / frequency ** rng.uniform(1.2, 2.0)
    noise = np.fft.irfft2(spectrum, (side, side))
    grey = rng.uniform(150, 215) + rng.uniform(4, 40) * (noise - noise.mean()) / noise.std()
    return np.asarray(np.repeat(grey[..., None], 3, axis=2), dtype=np.float64)
