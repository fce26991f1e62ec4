"""What has changed on the ground since the map was made, painted into the scene that the camera sees: any scene, any map.

The scene has no layers, so things are told apart by height: what stands more than `TALL_M` above its surroundings is a crown or
a house. Changes lie along the way that is flown, or everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.mapped.shadow import cast_shadow
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.ground_pixel import ground_gsd_m
from visloc_companion.sim.scene import Scene
from visloc_companion.types import FloatArray

Kind = Literal["water", "felled", "ploughed", "built"]
Plane = NDArray[np.float32]
Mask = NDArray[np.uint8]
TALL_M, FLAT_M = 3.0, 1.5
GROUND_M = 24.0
PARCEL_M, FURROW_M, PLOT_M, HOUSE_M, EAVES_M = 90.0, 1.6, 27.0, 11.0, 6.0
SUN_DEG = (212.0, 32.0)
SOILS = ((104, 82, 64), (132, 108, 84), (88, 72, 58), (150, 132, 104))
BRASH, STREET, ROOFS = (126, 104, 82), (120, 120, 122), ((150, 84, 64), (96, 94, 96), (128, 116, 108))


@dataclass(frozen=True, slots=True)
class Change:
    """One kind of change from `begin_m` to `end_m` of the way, `half_width_m` to either side, on `share` of the parcels.

    `all_else`: not there, but wherever the way before `begin_m` is not, so far to either side of it.
    """

    kind: Kind
    begin_m: float = 0.0
    end_m: float = np.inf
    half_width_m: float = 110.0
    share: float = 1.0
    all_else: bool = False


def lies(change: Change, scene: Scene, way_pix: FloatArray) -> Mask:
    """(H, W) 255 where a change is, before parcels are chosen, along a closed way (N, 2) of scene pix."""
    half_m = change.half_width_m
    if change.all_else:
        return np.bitwise_not(along_way(scene, way_pix, -half_m, change.begin_m, half_m))
    return along_way(scene, way_pix, change.begin_m, change.end_m, half_m)


def along_way(scene: Scene, way_pix: FloatArray, begin_m: float, end_m: float, half_width_m: float) -> Mask:
    """(H, W) 255 within a band along a piece of a closed way (N, 2) of scene pix; its ends are round."""
    M_ne_pix = _metres(scene)
    column_m, row_m = _sides_m(scene)
    closed = np.vstack([way_pix, way_pix[:1]])
    lengths_m = np.hypot(*(np.diff(closed, axis=0) @ M_ne_pix.T).T)
    at_m = np.concatenate([[0.0], np.cumsum(lengths_m)])
    first = begin_m + half_width_m
    last = max(first + 1.0, min(end_m - half_width_m, float(at_m[-1])))
    steps_m = np.append(np.arange(first, last, 5.0), last)
    points = np.column_stack([np.interp(steps_m, at_m, closed[:, axis]) for axis in (0, 1)])
    height, width = scene.dsm_amsl_m.shape
    square_height = round(height * row_m / column_m)  # drawn with square pixels, which those of a raster in degrees are not
    points[:, 1] = (points[:, 1] + 0.5) * square_height / height - 0.5
    mask = np.zeros((square_height, width), np.uint8)
    width_px = min(max(1, round(2 * half_width_m / column_m)), 32767)
    cv2.polylines(mask, [np.round(points).astype(np.int32)], isClosed=False, color=255, thickness=width_px)
    if square_height == height:
        return mask
    return np.asarray(cv2.resize(mask, (width, height), interpolation=cv2.INTER_NEAREST), dtype=np.uint8)


def changed(scene: Scene, change: Change, way_pix: FloatArray, seed: int) -> Scene:
    """The scene with one change. Deterministic by the seed."""
    inside = lies(change, scene, way_pix)
    rng = np.random.default_rng((seed, sum(map(ord, change.kind))))
    parcels = _parcels(scene, rng)
    inside[rng.random(int(parcels.max()) + 1)[parcels] >= change.share] = 0
    pixels, dsm = scene.pixels.copy(), scene.dsm_amsl_m.copy()
    ground = ground_below(dsm, _gsd_m(scene))
    match change.kind:
        case "felled":
            _fell(pixels, dsm, ground, inside > 0, rng)
        case "ploughed":
            _plough(pixels, inside & _where(dsm - ground < FLAT_M), parcels, rng, _gsd_m(scene))
        case "built":
            _build(pixels, dsm, ground, inside > 0, rng, _gsd_m(scene))
        case "water":
            dsm[inside > 0] = np.float32(np.median(ground[inside > 0])) if inside.any() else np.float32(0)
    return replace(scene, pixels=pixels, dsm_amsl_m=dsm)


def ground_below(dsm_m: Plane, gsd_m: float) -> Plane:
    """(H, W) heights of the bare ground, guessed: the lowest of each `GROUND_M`, smoothed."""
    side = max(1, round(GROUND_M / gsd_m))
    low = cv2.erode(dsm_m, np.ones((side, side), np.uint8))
    small = cv2.resize(low, None, fx=4 / side, fy=4 / side, interpolation=cv2.INTER_AREA) if side > 8 else low
    smooth = cv2.GaussianBlur(small, (0, 0), 4.0)
    return np.asarray(cv2.resize(smooth, (dsm_m.shape[1], dsm_m.shape[0])), dtype=np.float32)


def beyond_the_map(scene: Scene, margin_m: float) -> Scene:
    """The scene with land all around that no map has: its own, mirrored."""
    columns, rows = (round(margin_m / side_m) for side_m in _sides_m(scene))
    around = (rows, rows, columns, columns, cv2.BORDER_REFLECT)
    T = scene.T_map_pix.copy()
    T[:, 2] -= T[:, :2] @ np.array([columns, rows])
    pixels, dsm = cv2.copyMakeBorder(scene.pixels, *around), cv2.copyMakeBorder(scene.dsm_amsl_m, *around)
    return Scene(np.asarray(pixels, dtype=np.uint8), np.asarray(dsm, dtype=np.float32), T, scene.crs)


def _gsd_m(scene: Scene) -> float:
    return ground_gsd_m(map_crs(scene.crs), scene.T_map_pix, scene.dsm_amsl_m.shape)


def _metres(scene: Scene) -> FloatArray:
    """(2, 2) from columns and rows to metres north and east on the ground, in the middle of the scene."""
    J_map_ne = map_crs(scene.crs).linearised_at_map(*scene.center_map).J_map_ne
    return np.asarray(np.linalg.inv(J_map_ne) @ scene.T_map_pix[:, :2], dtype=np.float64)


def _sides_m(scene: Scene) -> tuple[float, float]:
    """Of a pixel on the ground, along columns and along rows."""
    column_m, row_m = np.hypot(*_metres(scene))
    return float(column_m), float(row_m)


def _where(condition: NDArray[np.bool_]) -> Mask:
    return condition.astype(np.uint8) * np.uint8(255)


def _parcels(scene: Scene, rng: np.random.Generator) -> NDArray[np.int32]:
    """(H, W) numbers of the parcel that each pixel belongs to (the nearest of scattered seeds), 1 and up."""
    height, width = scene.dsm_amsl_m.shape
    n = max(4, int(width * height * (_gsd_m(scene) / PARCEL_M) ** 2))
    away = np.full((height, width), 255, np.uint8)
    away[rng.integers(0, height, n), rng.integers(0, width, n)] = 0
    _, labels = cv2.distanceTransformWithLabels(away, cv2.DIST_L2, cv2.DIST_MASK_5)
    return np.asarray(labels, dtype=np.int32)


def _grain(rng: np.random.Generator, shape: tuple[int, ...], sigma: float) -> Plane:
    return np.asarray(rng.standard_normal(shape, dtype=np.float32) * np.float32(sigma), dtype=np.float32)


def _fell(pixels: NDArray[np.uint8], dsm: Plane, ground: Plane, inside: NDArray[np.bool_], rng: np.random.Generator) -> None:
    """What stands is gone; stumps, brash and tracks are left."""
    tall = _where(inside & (dsm - ground > TALL_M))
    gone = cv2.dilate(tall, np.ones((5, 5), np.uint8)) > 0
    n = int(gone.sum())
    dsm[gone] = ground[gone] + np.abs(_grain(rng, (n,), 0.3))
    pixels[gone] = np.clip(np.array(BRASH, np.float32) + _grain(rng, (n, 1), 16.0), 0, 255)


def _plough(pixels: NDArray[np.uint8], field: Mask, parcels: NDArray[np.int32], rng: np.random.Generator, gsd_m: float) -> None:
    """Every parcel another soil, with furrows its own way; ways and verges are ploughed in."""
    n = int(parcels.max()) + 1
    soil = np.array(SOILS, np.float32)[rng.integers(0, len(SOILS), n)]
    along = rng.uniform(0, np.pi, n).astype(np.float32)
    rows, cols = np.nonzero(field)
    mine = parcels[rows, cols]
    across = (cols * np.cos(along[mine]) + rows * np.sin(along[mine])) * np.float32(2 * np.pi * gsd_m / max(FURROW_M, 3 * gsd_m))
    light = 1 + 0.05 * np.sin(across) + _grain(rng, across.shape, 0.04)
    pixels[rows, cols] = np.clip(soil[mine] * light[:, None], 0, 255)


def _build(
    pixels: NDArray[np.uint8], dsm: Plane, ground: Plane, inside: NDArray[np.bool_], rng: np.random.Generator, gsd_m: float
) -> None:
    """An estate: houses on a turned grid of plots, streets between every other row, and their shadows."""
    turn = rng.uniform(0, np.pi / 2)
    rows, cols = np.nonzero(inside)
    x = (cols * np.cos(turn) + rows * np.sin(turn)) * gsd_m
    y = (rows * np.cos(turn) - cols * np.sin(turn)) * gsd_m
    dsm[inside] = ground[inside]
    pixels[inside] = np.clip(pixels[inside] * 0.3 + np.array((84, 92, 60), np.float32) + _grain(rng, (len(x), 1), 6.0), 0, 255)
    street = np.mod(y, 2 * PLOT_M) < 6.0
    pixels[rows[street], cols[street]] = STREET
    house = (np.abs(np.mod(x, PLOT_M) - PLOT_M / 2) < HOUSE_M / 2) & (np.abs(np.mod(y, PLOT_M) - PLOT_M * 0.6) < HOUSE_M * 0.4)
    number = (np.floor(x / PLOT_M) * 7 + np.floor(y / PLOT_M) * 13).astype(np.int64)
    height = EAVES_M + np.mod(number, 3)
    dsm[rows[house], cols[house]] += height[house].astype(np.float32)
    pixels[rows[house], cols[house]] = np.array(ROOFS, np.uint8)[np.mod(number[house], len(ROOFS))]
    shaded = np.clip(cast_shadow(dsm, gsd_m, *SUN_DEG) / 1.2, 0, 1)[inside][:, None]
    pixels[inside] = np.clip(pixels[inside] * (1 - 0.55 * shaded), 0, 255)
