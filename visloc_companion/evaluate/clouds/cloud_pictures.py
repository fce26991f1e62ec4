"""Pictures of single cloud cases: height maps of both clouds at the truth and where the answer put the source."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import MapError
from visloc_companion.evaluate.clouds.cloud_cases import BadCloudCase, CloudCase
from visloc_companion.localise.registration.clouds import density_per_m2, middle_m
from visloc_companion.maps.cloud import read_cloud
from visloc_companion.types import FloatArray, Image

SIDE_PX = 220
ROOM = 1.4
"""Side of a picture over that of the source."""
FINEST_CELL_M = 0.5
POINTS_PER_CELL = 3.0
DIFFERENCE_M = 5.0
"""Height differences of this much have the full colour."""
UNKNOWN = (60, 60, 60)


@dataclass(frozen=True, slots=True, eq=False)
class CloudPictures:
    """(SIDE_PX, SIDE_PX, 3) RGB each, north up, one scale: both clouds about the truth and about the answer (None where there is
    none), and source less reference at the answer (red above, blue below)."""

    source_at_truth: Image | None
    reference_at_truth: Image | None
    source_at_answer: Image | None
    reference_at_answer: Image | None
    difference: Image | None


def cloud_pictures(case: CloudCase | BadCloudCase, T_true: FloatArray | None, T_found: FloatArray | None) -> CloudPictures | None:
    """The pictures of a case, None where its files cannot be read."""
    if isinstance(case, BadCloudCase):
        return None
    try:
        source, reference = read_cloud(case.source).points_m, read_cloud(case.reference).points_m
    except MapError:
        return None
    side_m = ROOM * float(np.ptp(source[:, :2], axis=0).max())
    cell_m = max(FINEST_CELL_M, float(np.sqrt(POINTS_PER_CELL / min(density_per_m2(source), density_per_m2(reference)))))
    count = max(2, round(side_m / cell_m))
    pair_true, pair_found = (None if T is None else _pair(source, reference, T, side_m, count) for T in (T_true, T_found))
    shown = np.concatenate([pair[1].ravel() for pair in (pair_true, pair_found) if pair is not None] or [np.zeros(1)])
    known = shown[np.isfinite(shown)]
    low, high = (float(v) for v in np.percentile(known, (2, 98))) if known.size else (0.0, 1.0)
    pictures = [coloured(grid, low, high) for pair in (pair_true, pair_found) if pair is not None for grid in pair]
    at_truth = pictures[:2] if pair_true is not None else [None, None]
    at_answer = pictures[-2:] if pair_found is not None else [None, None]
    difference = None if pair_found is None else coloured_difference(pair_found[0] - pair_found[1])
    return CloudPictures(at_truth[0], at_truth[1], at_answer[0], at_answer[1], difference)


def height_map(points_m: FloatArray, middle_m: FloatArray, side_m: float, count: int) -> FloatArray:
    """(count, count) height of the highest point in each cell of a square about (2,) `middle_m`, north up; NaN without points."""
    cell = side_m / count
    col = np.floor((points_m[:, 0] - middle_m[0] + side_m / 2) / cell).astype(int)
    row = np.floor((middle_m[1] + side_m / 2 - points_m[:, 1]) / cell).astype(int)
    inside = (col >= 0) & (col < count) & (row >= 0) & (row < count)
    top = np.full(count * count, -np.inf)
    np.maximum.at(top, row[inside] * count + col[inside], points_m[inside, 2])
    return np.where(np.isfinite(top), top, np.nan).reshape(count, count)


def coloured(heights: FloatArray, low: float, high: float) -> Image:
    """Heights from dark blue at `low` to yellow at `high`."""
    share = (np.nan_to_num(heights, nan=low) - low) / max(high - low, 1e-6)
    return _painted(cv2.applyColorMap(_byte(share), cv2.COLORMAP_VIRIDIS)[..., ::-1], np.isfinite(heights))


def coloured_difference(metres: FloatArray) -> Image:
    """Differences from blue (-DIFFERENCE_M) over white to red."""
    share = np.clip(np.nan_to_num(metres) / DIFFERENCE_M, -1, 1)[..., None]
    white, red, blue = np.array([245, 245, 245]), np.array([190, 20, 30]), np.array([20, 60, 190])
    mixed = white + np.abs(share) * (np.where(share > 0, red, blue) - white)
    return _painted(mixed.astype(np.uint8), np.isfinite(metres))


def _pair(source: FloatArray, reference: FloatArray, T: FloatArray, side_m: float, count: int) -> tuple[FloatArray, FloatArray]:
    """Height maps of the placed source and of the reference on the square about the placed source's middle."""
    placed = source @ T[:3, :3].T + T[:3, 3]
    middle = middle_m(placed)[:2]
    return height_map(placed, middle, side_m, count), height_map(reference, middle, side_m, count)


def _painted(picture: NDArray[Any], known: NDArray[np.bool_]) -> Image:
    full = np.where(known[..., None], picture, UNKNOWN).astype(np.uint8)
    return cv2.resize(full, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_NEAREST).astype(np.uint8, copy=False)


def _byte(share: FloatArray) -> NDArray[np.uint8]:
    return np.clip(np.rint(255 * share), 0, 255).astype(np.uint8)
