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
import rasterio
from numpy.typing import NDArray
from rasterio.errors import RasterioError

from visloc_companion.errors import MapError
from visloc_companion.evaluate.case_map import picture_of
from visloc_companion.evaluate.cases import BadCase, Case, Truth, read_frame
from visloc_companion.evaluate.image_metrics import WRONG_PX, CaseResult, case_error
from visloc_companion.geo.raster import T_map_pix_from_gdal, apply_affine, invert_affine
from visloc_companion.maps.crs import map_crs

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


@dataclass(frozen=True, slots=True, eq=False)
class _Layers:
    water: NDArray[np.bool_]
    deviation: NDArray[np.float16]
    to_pix: Callable[[float, float], tuple[float, float]]
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
    frame, layers = read_frame(case.frame), _layers(case.ortho)
    if frame is None or layers is None:
        return None
    u, v = layers.to_pix(truth.lat_deg, truth.lon_deg)
    half = max(4.0, min(frame.shape[:2]) / 2 * agl_m / case.camera.fx_px / layers.gsd_m)
    rows = slice(max(0, int(v - half)), max(0, int(v + half) + 1))
    cols = slice(max(0, int(u - half)), max(0, int(u + half) + 1))
    water, deviation = layers.water[rows, cols], layers.deviation[rows, cols]
    if not water.size:
        return None
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
def _layers(ortho: Path) -> _Layers | None:
    try:
        with rasterio.open(picture_of(ortho)) as source:
            bands = source.read().astype(np.float32)
            crs, transform = source.crs, source.transform
    except (RasterioError, MapError):
        return None
    grey = bands[:3].mean(0)
    box = (WINDOW_PX, WINDOW_PX)
    mean = cv2.blur(grey, box)
    deviation = np.sqrt(np.maximum(cv2.blur(grey * grey, box) - mean * mean, 0))
    if len(bands) >= 4:
        water = (bands[1] - bands[3]) / (bands[1] + bands[3] + 1) > WATER_NDWI
    else:
        water = (mean < WATER_GREY) & (deviation < WATER_DEVIATION)
    where, T_map_pix = map_crs(crs.to_wkt()), T_map_pix_from_gdal(tuple(transform)[:6])
    T_pix_map = invert_affine(T_map_pix)

    def to_pix(lat_deg: float, lon_deg: float) -> tuple[float, float]:
        u, v = apply_affine(T_pix_map, np.array(where.to_map(lat_deg, lon_deg)))
        return float(u), float(v)

    rows, cols = grey.shape
    J = where.linearised_at_map(*(float(x) for x in T_map_pix @ np.array([cols / 2, rows / 2, 1.0]))).J_map_ne
    gsd_m = math.sqrt(abs(float(np.linalg.det(T_map_pix[:, :2]) / np.linalg.det(J))))
    return _Layers(np.asarray(water, dtype=np.bool_), deviation.astype(np.float16), to_pix, gsd_m)
