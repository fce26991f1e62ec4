"""Where the keyframe's rays meet the ground: the map's surface where it is given, else a level plane under the camera."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.geo.raster import apply_affine, invert_affine
from visloc_companion.geo.ray import intersect_surface
from visloc_companion.localise.mapped.surface_error import LOCAL_SHARE, above_opening, unresolved_of, unresolved_parts
from visloc_companion.localise.odometry.base import FlowSettings, Sight, Surface
from visloc_companion.localise.odometry.solve import Ground
from visloc_companion.types import FloatArray, Vec2

STEEPEST = math.cos(math.radians(72.0))
"""Rays flatter than this (72 degrees from straight down) see too much relief for each pixel."""
READING_APART_M = 10.0
"""Heights read closer to each other than this see the same tree or roof."""
REACH = 0.7
"""Heights read further from the camera's foot, and from the middle of what it sees, than this share of the height say nothing of
the ground in view."""
ROW = 8192
SMOOTHED, LEAST_ABOVE_M = 0.13, 1.0
"""1-sigma of a Gaussian, as a share of the height: whether a point lies on a wood or on the field beside it is known, on which
side of a crown is not, where attitude and place are off by metres."""


@dataclass(frozen=True, slots=True)
class Reading:
    """A height above the surface read at a place (north, east of any origin) from an altitude. `sigma_range_m`: a rangefinder's,
    of what stays wrong with it; the altitude is as the instrument has it then, for nothing is added to a distance. None: it is of
    what the keyframe's sight says."""

    place_ne_m: Vec2
    up_m: float
    height_m: float
    sigma_range_m: float | None = None


def descends(rays_ned: FloatArray) -> NDArray[np.bool_]:
    """(N,) which rays look down steeply enough."""
    return np.asarray(rays_ned[:, 2] > STEEPEST * np.linalg.norm(rays_ned, axis=1), dtype=np.bool_)


def on_plane(rays_ned: FloatArray, sight: Sight, settings: FlowSettings) -> Ground:
    """Points of a level plane straight below; what it departs by from the true ground is the settings' relief and slope."""
    at = rays_ned * (sight.height_m / rays_ned[:, 2:3])
    level = 3 * settings.relief_m + settings.slope_rad * sight.height_m
    up = 0.0 if sight.ranged else sight.sigma_height_m
    return Ground(at, np.full(len(at), settings.relief_m), np.zeros(len(at), np.bool_), level, settings.slope_rad, up)


def on_surface(rays_ned: FloatArray, sight: Sight, surface: Surface, settings: FlowSettings) -> Ground | None:
    """Points of the surface model that the rays meet; rays that miss it have NaN. None where the camera is not above it."""
    lookup = _Lookup(surface, sight.sigma_place_m, settings)
    low, high = float(np.nanmin(surface.up_m)), float(np.nanmax(surface.up_m))
    if not sight.up_m > low + settings.min_height_m:
        return None
    camera = np.array([*sight.place_ne_m, -sight.up_m])
    met = intersect_surface(camera, rays_ned, lookup.height, min(high + 0.1, sight.up_m - 1.0), low - 0.1)
    spread = lookup.spread(met[:, :2])
    known = np.isfinite(spread)
    if not known.any():
        return Ground(met - camera, spread, ~known, math.inf, math.inf, sight.sigma_up_m)
    moved = _rms_when_moved(lookup, met[known], sight.sigma_place_m)
    between_m = unresolved_of(surface.filled_up_m, surface.pixel_m, surface.dsm_gsd_m)
    shared_m, leans_rad, own_m = unresolved_parts(met[known, :2], between_m, surface.dsm_gsd_m)
    level = math.hypot(settings.surface_m, settings.surface_share * float(np.median(spread[known])), moved, shared_m)
    slope = math.hypot(settings.surface_slope_rad, moved / (sight.up_m + float(np.median(met[known, 2]))), leans_rad)
    spread = np.hypot(np.hypot(spread, LOCAL_SHARE * lookup.standing(met[:, :2])), own_m)
    none = np.zeros(len(met), np.bool_)
    return Ground(met - camera, spread, none, level, slope, sight.sigma_up_m, coarse=between_m > 0)


def heights_above(rays_ned: FloatArray, camera_up_m: float, surface: Surface) -> FloatArray:
    """(N,) by how much a camera above the origin of a surface model is higher than what rays (N, 3) meet of it, smoothed to
    SMOOTHED of its height; NaN where that is not known."""
    known = np.isfinite(surface.up_m)
    low = float(np.nanmin(surface.up_m)) if known.any() else math.inf
    if not camera_up_m > low + LEAST_ABOVE_M:
        return np.full(len(rays_ned), math.nan)
    sigma_px = max(0.5, SMOOTHED * (camera_up_m - low) / surface.pixel_m)
    smooth = cv2.GaussianBlur(surface.filled_up_m, (0, 0), sigma_px)
    up_m, A_pix_ne = np.where(known, smooth, np.float32(math.nan)), invert_affine(surface.A_ne_pix)
    highest = min(float(smooth.max()) + 0.1, camera_up_m - 0.5 * LEAST_ABOVE_M)
    camera = np.array([0.0, 0.0, -camera_up_m])
    met = intersect_surface(camera, rays_ned, lambda ne: _at(up_m, A_pix_ne, ne), highest, low - 0.1)
    return np.asarray(met[:, 2] + camera_up_m, dtype=np.float64)


def read_near(
    readings: Sequence[Reading], place_ne_m: FloatArray, up_m: float, height_m: float, seen_ne_m: FloatArray
) -> FloatArray:
    """(M, 3) where heights that were read near a keyframe, or near the middle (2,) of what it sees from there (one that leans
    by 20 degrees and more looks at ground that it is not above), found the surface: north, east, down from its camera."""
    found: list[tuple[float, float, float]] = []
    elsewhere = math.hypot(*seen_ne_m) > REACH / 2 * height_m
    for reading in readings:
        north, east = reading.place_ne_m[0] - place_ne_m[0], reading.place_ne_m[1] - place_ne_m[1]
        away_m = math.hypot(north, east)
        if elsewhere:
            away_m = min(away_m, math.hypot(north - seen_ne_m[0], east - seen_ne_m[1]))
        if away_m <= REACH * height_m:
            found.append((north, east, reading.height_m - (reading.up_m - up_m)))
    return np.array(found).reshape(-1, 3)


def _rms_when_moved(lookup: _Lookup, met: FloatArray, sigma_m: float) -> float:
    """By how much the mean height of the points changes when all are moved by a sigma of the place, four ways."""
    here = lookup.height(met[:, :2])
    found = []
    for way in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)):
        change = lookup.height(met[:, :2] + sigma_m * np.array(way)) - here
        found.append(float(np.mean(change[np.isfinite(change)])) if np.isfinite(change).any() else 0.0)
    return float(np.sqrt(np.mean(np.square(found)))) * math.sqrt(2.0)


class _Lookup:
    """Heights of a surface model, and how sure they are where the camera's place is not."""

    def __init__(self, surface: Surface, sigma_place_m: float, settings: FlowSettings) -> None:
        self._A_pix_ne = invert_affine(surface.A_ne_pix)
        self._up = np.ascontiguousarray(surface.up_m, dtype=np.float32)
        pixel_m = surface.pixel_m
        side = 2 * max(1, round(1.5 * max(sigma_place_m, pixel_m) / pixel_m)) + 1
        known = surface.filled_up_m
        middle = np.float32(known.mean())
        mean = cv2.blur(known - middle, (side, side))
        variance = cv2.blur((known - middle) ** 2, (side, side)) - mean**2
        self._spread = np.sqrt(np.maximum(variance, 0) + np.float32(settings.surface_m**2))
        self._standing = _of_each_pixel(*above_opening(known, pixel_m), self._up.shape)

    def height(self, ne: FloatArray) -> FloatArray:
        """(N,) heights at (N, 2) north, east; NaN outside."""
        return _at(self._up, self._A_pix_ne, ne)

    def spread(self, ne: FloatArray) -> FloatArray:
        """(N,) 1-sigma of the heights."""
        return _at(self._spread.astype(np.float32), self._A_pix_ne, ne)

    def standing(self, ne: FloatArray) -> FloatArray:
        """(N,) heights of what stands on the ground."""
        return _at(self._standing, self._A_pix_ne, ne)


def _at(layer: NDArray[np.float32], A_pix_ne: FloatArray, ne: FloatArray) -> FloatArray:
    """(N,) a layer (H, W) at (N, 2) north, east; NaN outside."""
    pix = np.nan_to_num(apply_affine(A_pix_ne, ne), nan=-9.0).astype(np.float32)
    u, v = (np.ascontiguousarray(pix[:, k : k + 1]) for k in (0, 1))
    border = {"borderMode": cv2.BORDER_CONSTANT, "borderValue": math.nan}
    return np.asarray(cv2.remap(layer, u, v, cv2.INTER_LINEAR, **border), dtype=np.float64).ravel()  # type: ignore[call-overload]


def _of_each_pixel(above_m: NDArray[np.float32], step: int, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """(H, W) of what is given for squares of so many pixels; the rim that no square covers is as its neighbour."""
    height, width = above_m.shape
    fine = cv2.resize(above_m, (width * step, height * step), interpolation=cv2.INTER_LINEAR)
    rim = (0, max(0, shape[0] - height * step)), (0, max(0, shape[1] - width * step))
    return np.asarray(np.pad(fine, rim, mode="edge")[: shape[0], : shape[1]], dtype=np.float32)
