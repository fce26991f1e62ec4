"""Cases of other cameras and maps: the same places, dates and priors for every variation, so that rows compare pair by pair.

Frames are of one NAIP date, maps of another, cameras over rows >= 400 (`SCORED_ROWS`); the camera is the shared tool's (256 px,
60 degrees, nadir).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.transform import Affine

from benchmarks.image_cases.cases import SHARED, maker, write_tables
from benchmarks.image_cases.frames import Place, anywhere, case_rows, cut
from benchmarks.image_cases.sensor_maps import MAPS
from benchmarks.image_cases.sensor_variations import FRAMES, NOT_OF_THIS_CAMERA, Bands, colour
from benchmarks.image_cases.sets import PLACE, SCORED_ROWS
from visloc_companion.types import Image

NOISE_GREY, SEED = 3.0, 31
Taken = tuple[Image, dict[str, float]]
"""A picture and its `fx_px`, `fy_px`, `cx_px` and `cy_px`."""
Rows = tuple[dict[str, Any], dict[str, Any]]
"""Of a case: its row of cases.csv and that of truth.csv."""


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """A case before anything is varied: what the camera's sensor has (`bands`), its place, and a date that is neither the frame's
    nor the map's."""

    bands: Bands
    place: Place
    second: Path


def resized(width_px: int, height_px: int, *, portrait: bool = False) -> Callable[[Bands], Taken]:
    """The middle of the picture, 4:3 or (portrait) 3:4, at another size, whose pixels are squares where the sides allow."""

    def taken(bands: Bands) -> Taken:
        side = bands.shape[0]
        cropped = (side * 3 // 4, side) if portrait else (side, side * 3 // 4)
        left, top = (side - cropped[0]) // 2, (side - cropped[1]) // 2
        picture = colour(bands)[top : top + cropped[1], left : left + cropped[0]]
        scale = width_px / cropped[0], height_px / cropped[1]
        how = cv2.INTER_CUBIC if max(scale) > 1 else cv2.INTER_AREA
        tool = maker()
        centre = ((tool.CENTRE_PX - start + 0.5) * s - 0.5 for start, s in zip((left, top), scale, strict=True))
        names = "fx_px", "fy_px", "cx_px", "cy_px"
        values = tool.FOCAL_PX * scale[0], tool.FOCAL_PX * scale[1], *centre
        pixels = np.asarray(cv2.resize(picture, (width_px, height_px), interpolation=how), dtype=np.uint8)
        return pixels, dict(zip(names, values, strict=True))

    return taken


SIZES: dict[str, Callable[[Bands], Taken]] = {
    "320 x 240": resized(320, 240),
    "4000 x 3000": resized(4000, 3000),
    "portrait, 480 x 640": resized(480, 640, portrait=True),
    "pixels 1.5 times as wide as high": resized(320, 360),
}


@cache
def sites(n: int, foot_px: float, seed: int = SEED) -> list[Site]:
    """So many sites; the same ones first, whatever `n` is."""
    rng, dates = np.random.default_rng(seed), sorted((SHARED / "data" / "naip").glob("*.tif"))
    found: list[Site] = []
    while len(found) < n:
        frame_file, map_file, second = (dates[k] for k in rng.choice(len(dates), 3, replace=False))
        bands, transform, crs = four_bands(frame_file)
        margin = 0.62 * foot_px
        at = anywhere(rng, bands.shape, margin)
        names = map_file.stem, frame_file.stem
        place = cut(rng, bands, at, (map_file, transform, crs), at, PLACE, foot_px, names, True)
        light, noise = rng.uniform(0.8, 1.2), rng.normal(0, NOISE_GREY, (256, 256, 4))
        if place is not None and max(SCORED_ROWS[0], margin) <= at[1] <= SCORED_ROWS[1]:
            found.append(Site(np.clip(place.frame * light + noise, 0, 255).astype(np.uint8), place, second))
    return found


def of_frames(root: Path, name: str, n: int, foot_px: float) -> Path:
    """The folder of cases whose frames are varied (`FRAMES` or `SIZES`), over the map as it is."""

    def rows(folder: Path, number: int, site: Site) -> Rows:
        pixels, calibration = _taken(name, site.bands, number)
        case, truth = _written(folder, number, site, pixels)
        return case | calibration, truth | {"solvable": int(name not in NOT_OF_THIS_CAMERA)}

    return _cases(root / f"frame {name}", n, foot_px, rows)


def of_maps(root: Path, name: str, n: int, foot_px: float) -> Path:
    """The folder of cases whose maps are varied (`MAPS`), under the frames in colour."""

    def rows(folder: Path, number: int, site: Site) -> Rows:
        case, truth = _written(folder, number, site, colour(site.bands))
        return case | {"ortho": str(_varied_map(folder, name, site).resolve())}, truth

    return _cases(root / f"map {name}", n, foot_px, rows)


def _cases(folder: Path, n: int, foot_px: float, rows: Callable[[Path, int, Site], Rows]) -> Path:
    """The folder, made where it is not there yet, of one case a site."""
    if (folder / "cases.csv").exists():
        return folder
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    tables = [rows(folder, number, site) for number, site in enumerate(sites(n, foot_px))]
    return write_tables(folder, *zip(*tables, strict=True))


@cache
def four_bands(path: Path) -> tuple[Bands, Any, Any]:
    """(H, W, 4) of a NAIP date, its transform and CRS."""
    with rasterio.open(path) as source:
        return np.ascontiguousarray(source.read().transpose(1, 2, 0)), source.transform, source.crs


def _taken(name: str, bands: Bands, number: int) -> Taken:
    if name in SIZES:
        return SIZES[name](bands)
    return FRAMES[name](bands, np.random.default_rng([SEED, number])), {}


def _written(folder: Path, number: int, site: Site, pixels: Image) -> Rows:
    case, truth = case_rows(f"site{number:04d}", site.place, PLACE, np.random.default_rng([SEED, 1, number]))
    cv2.imwrite(str(folder / case["frame"]), pixels if pixels.ndim == 2 else pixels[..., ::-1])
    return case, truth


def _varied_map(folder: Path, name: str, site: Site) -> Path:
    first = site.place.ortho
    mosaic = name == "seams of two dates"
    file = folder / "maps" / f"{first.stem}{'_' + site.second.stem if mosaic else ''}.tif"
    if not file.exists():
        bands, transform, crs = four_bands(first)
        drawn = MAPS[name](bands, four_bands(site.second)[0], np.random.default_rng([SEED, int(first.stem)]))
        coarser = bands.shape[1] // drawn.shape[1]
        grid = Affine(transform.a * coarser, 0.0, transform.c, 0.0, transform.e * coarser, transform.f)
        write_map(file, drawn, grid, crs)
    return file


def write_map(file: Path, picture: Image | NDArray[np.uint8], transform: Affine, crs: Any) -> None:
    """(H, W) or (H, W, 3) as a GeoTIFF."""
    file.parent.mkdir(parents=True, exist_ok=True)
    layers = picture[None] if picture.ndim == 2 else picture.transpose(2, 0, 1)
    shape = {"count": len(layers), "height": layers.shape[1], "width": layers.shape[2]}
    with rasterio.open(file, "w", driver="GTiff", dtype="uint8", crs=crs, transform=transform, **shape) as target:
        target.write(layers)
