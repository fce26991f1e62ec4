"""What the errors of an image evaluation depend on: years between the dates, season, land cover, texture.

Labels come from the truth's dates (YYYYMMDD) and from the map under the frame, by these rules:
* water: the normalised difference of green and near infrared exceeds 0.15 where the map has four bands (McFeeters 1996), else a
  pixel that is dark (grey < 90) and smooth (deviation < 3 grey levels over 7 x 7 px);
* cover: `water` where more than half of the footprint is water, `shore` above 15 %, else `rough` (woods, wetland, towns) where
  the deviation over 7 x 7 px is above 8 grey levels on more than half of it, else `smooth` (fields, grass, bare ground);
* texture: quartiles, over all labelled cases, of that deviation's mean over the footprint.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rasterio.errors import RasterioError
from rasterio.windows import Window

from visloc_companion.errors import MapError, OutsideMap
from visloc_companion.evaluate.cases import BadCase, Case, Truth, read_frame
from visloc_companion.evaluate.images.case_map import picture_of
from visloc_companion.evaluate.images.image_metrics import WRONG_PX, CaseResult, case_error
from visloc_companion.geo.raster import T_map_pix_from_gdal, apply_affine, invert_affine
from visloc_companion.maps.from_white import as_shown
from visloc_companion.maps.geotiff import crs_of
from visloc_companion.maps.ground_pixel import ground_gsd_m
from visloc_companion.maps.world_file import open_raster

WATER_NDWI, WATER_GREY, WATER_DEVIATION, ROUGH_DEVIATION = 0.15, 90.0, 3.0, 8.0
WINDOW_PX = 7
COVERS = ("water", "shore", "rough", "smooth")
GROUPS = ("years between the dates", "days between the seasons", "land cover", "texture of the map")
Judged = tuple[CaseResult, Truth]


@dataclass(frozen=True, slots=True)
class Ground:
    """The map under a frame: its cover, and the mean deviation of grey over small windows (grey levels)."""

    cover: str
    texture: float


@dataclass(frozen=True, slots=True)
class GroupFigures:
    """Figures of the cases with one label. `error_px` is the mean of all answers, `accepted` counts those not refused."""

    group: str
    label: str
    n: int
    within_5px: float
    within_2px: float
    error_px: float | None
    accepted: int
    far: int


@dataclass(frozen=True, slots=True)
class _Picture:
    """The file that shows a map, and where places lie in it."""

    path: Path
    to_pix: Callable[[float, float], tuple[float, float]]
    shape: tuple[int, int]
    """(rows, cols)."""
    gsd_m: float


def breakdown(judged: Sequence[Judged], grounds: dict[str, Ground], max_probability_wrong: float = 1.0) -> list[GroupFigures]:
    """Figures by label, group after group; only solvable cases count, and groups of which nothing is known are left out.

    `grounds` by case id (`ground_under`). Fixes that claim more than `max_probability_wrong` count as answers, not as accepted.
    """
    solvable = [(r, t) for r, t in judged if t.solvable]
    edges = np.percentile([g.texture for g in grounds.values()], (25, 50, 75)) if grounds else np.zeros(3)
    found: list[GroupFigures] = []
    for group in GROUPS:
        by_label: dict[tuple[int, str], list[Judged]] = {}
        for result, truth in solvable:
            label = _label(group, truth, grounds.get(result.case_id), edges)
            if label is not None:
                by_label.setdefault(label, []).append((result, truth))
        found += [_figures(group, label[1], by_label[label], max_probability_wrong) for label in sorted(by_label)]
    return found


def ground_under(case: Case | BadCase, truth: Truth, agl_m: float) -> Ground | None:
    """The map within the square about the camera that the frame covers from `agl_m` above the ground; None where unreadable."""
    if isinstance(case, BadCase):
        return None
    frame, picture = read_frame(case.frame), _picture(case.ortho)
    if frame is None or picture is None:
        return None
    try:
        u, v = picture.to_pix(truth.lat_deg, truth.lon_deg)
    except OutsideMap:
        return None
    half = max(4.0, min(frame.shape[:2]) / 2 * agl_m / case.camera.fx_px / picture.gsd_m)
    rows, cols = (
        (min(size, max(0, int(at - half))), min(size, max(0, int(at + half) + 1)))
        for at, size in zip((v, u), picture.shape, strict=True)
    )
    layers = _layers(picture.path, rows, cols) if rows[0] < rows[1] and cols[0] < cols[1] else None
    if layers is None:
        return None
    water, deviation = layers
    share, rough = float(water.mean()), float((deviation > ROUGH_DEVIATION).mean())
    cover = "water" if share > 0.5 else "shore" if share > 0.15 else "rough" if rough > 0.5 else "smooth"
    return Ground(cover, float(deviation.mean(dtype=np.float64)))


def grounds_under(judged: Sequence[Judged], cases: Mapping[str, Case | BadCase]) -> dict[str, Ground]:
    """By case id, the ground under every solvable case whose files can be read."""
    found = {}
    for result, truth in judged:
        agl_m = result.evidence.get("agl_m") or truth.h_m
        if result.case_id in cases and truth.solvable and math.isfinite(agl_m):
            ground = ground_under(cases[result.case_id], truth, agl_m)
            if ground is not None:
                found[result.case_id] = ground
    return found


def years_apart(a: str, b: str) -> float | None:
    """Years between two dates written YYYYMMDD, None where one is none."""
    days = _days(a), _days(b)
    return abs(days[0] - days[1]) / 365.25 if days[0] is not None and days[1] is not None else None


def season_days_apart(a: str, b: str) -> float | None:
    """Days between two dates within the circle of the year, 0 to 183."""
    days = _days(a), _days(b)
    if days[0] is None or days[1] is None:
        return None
    apart = abs(days[0] - days[1]) % 365.25
    return min(apart, 365.25 - apart)


def _label(group: str, truth: Truth, ground: Ground | None, edges: NDArray[np.float64]) -> tuple[int, str] | None:
    """Order and words of the label of one case in a group, None where it has none."""
    if group == GROUPS[0]:
        return _between(years_apart(truth.map_date, truth.frame_date), (0.01, 1.5, 3.5, 6.5))
    if group == GROUPS[1]:
        return _between(season_days_apart(truth.map_date, truth.frame_date), (0.5, 15, 30, 60))
    if ground is None:
        return None
    if group == GROUPS[2]:
        return COVERS.index(ground.cover), ground.cover
    quartile = int(np.searchsorted(edges, ground.texture))
    return quartile, f"quartile {quartile + 1} of 4, {('smoothest', 'smooth', 'rough', 'roughest')[quartile]}"


def _between(value: float | None, edges: tuple[float, ...]) -> tuple[int, str] | None:
    """Which interval a value lies in; the first edge only tells zero from more."""
    if value is None:
        return None
    place = int(np.searchsorted(edges, value))
    if place == 0:
        return 0, "none"
    low = f"above {edges[place - 1]:g}" if place > 1 else ""
    high = f"up to {edges[place]:g}" if place < len(edges) else ""
    return place, ", ".join(part for part in (low, high) if part)


def _figures(group: str, label: str, judged: Sequence[Judged], max_probability_wrong: float) -> GroupFigures:
    answers = [(r.fix.probability_wrong, e) for r, t in judged if r.fix is not None and (e := case_error(r, t)) is not None]
    px = np.array([e.horizontal_px for _, e in answers])
    taken = [e for p, e in answers if p <= max_probability_wrong]
    return GroupFigures(
        group,
        label,
        n=len(judged),
        within_5px=float((px < WRONG_PX).sum()) / len(judged),
        within_2px=float((px < 2.0).sum()) / len(judged),
        error_px=float(px.mean()) if px.size else None,
        accepted=len(taken),
        far=sum(e.far for e in taken),
    )


def _days(text: str) -> int | None:
    try:
        return date(int(text[:4]), int(text[4:6]), int(text[6:8])).toordinal() if len(text) == 8 else None
    except ValueError:
        return None


@lru_cache(maxsize=4)
def _picture(ortho: Path) -> _Picture | None:
    try:
        path = picture_of(ortho)
        where, _ = crs_of(path)
        with open_raster(path) as source:
            shape, transform = (int(source.height), int(source.width)), source.transform
    except (RasterioError, MapError):
        return None
    T_map_pix = T_map_pix_from_gdal(tuple(transform)[:6])
    T_pix_map = invert_affine(T_map_pix)

    def to_pix(lat_deg: float, lon_deg: float) -> tuple[float, float]:
        u, v = apply_affine(T_pix_map, np.array(where.to_map(lat_deg, lon_deg)))
        return float(u), float(v)

    return _Picture(path, to_pix, shape, ground_gsd_m(where, T_map_pix, shape, str(path)))


def _layers(path: Path, rows: tuple[int, int], cols: tuple[int, int]) -> tuple[NDArray[np.bool_], NDArray[np.float32]] | None:
    """Water, and the deviation of grey over small windows, on a part of a picture: whole ones may be larger than the memory."""
    top, left = max(0, rows[0] - WINDOW_PX // 2), max(0, cols[0] - WINDOW_PX // 2)
    part = ((top, rows[1] + WINDOW_PX // 2), (left, cols[1] + WINDOW_PX // 2))
    try:
        with open_raster(path) as source:
            bands = source.read(window=Window.from_slices(*part, height=source.height, width=source.width))
            bands = as_shown(source, bands).astype(np.float32)
    except RasterioError:
        return None
    grey = bands[:3].mean(0)
    box = (WINDOW_PX, WINDOW_PX)
    mean = cv2.blur(grey, box)
    deviation = np.sqrt(np.maximum(cv2.blur(grey * grey, box) - mean * mean, 0))
    if len(bands) >= 4:
        water = (bands[1] - bands[3]) / (bands[1] + bands[3] + 1) > WATER_NDWI
    else:
        water = (mean < WATER_GREY) & (deviation < WATER_DEVIATION)
    inside = np.s_[rows[0] - top : rows[1] - top, cols[0] - left : cols[1] - left]
    return np.asarray(water, dtype=np.bool_)[inside], np.asarray(deviation[inside], dtype=np.float32)
