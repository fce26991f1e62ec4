"""Stamps crowns and roofs onto the height layer: each keeps what is higher, as the sky sees it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from visloc_companion.sim.land.landscape_grid import Grid
from visloc_companion.sim.land.landscape_noise import Raster
from visloc_companion.sim.land.landscape_objects import Building, Trees
from visloc_companion.sim.land.season import Season

VARIANTS = 8


@dataclass(frozen=True)
class Objects:
    """What stands on the ground: height above it (m), number of the tree (-1: none), its shade (128 = 1), roof tone (0: none)."""

    height_m: Raster
    tree: NDArray[np.int32]
    shade: NDArray[np.uint8]
    roof: NDArray[np.uint8]


def stamp_objects(
    grid: Grid,
    trees: Trees,
    buildings: tuple[Building, ...],
    standing: NDArray[np.bool_],
    blocked: NDArray[np.uint8],
    season: Season,
) -> Objects:
    """Objects of one date. `standing` picks trees; none stands where `blocked` is set (roads and water)."""
    shape = (grid.size_px, grid.size_px)
    layers = Objects(
        np.zeros(shape, np.float32), np.full(shape, -1, np.int32), np.full(shape, 128, np.uint8), np.zeros(shape, np.uint8)
    )
    for building in buildings:
        if building.at_map or season.years > 0:
            _stamp_roof(grid, layers, building)
    _stamp_crowns(grid, layers, trees, standing, blocked, season)
    return layers


def _stamp_crowns(
    grid: Grid, layers: Objects, trees: Trees, standing: NDArray[np.bool_], blocked: NDArray[np.uint8], season: Season
) -> None:
    size = grid.size_px
    at = np.round(grid.pix(trees.xy_m)).astype(int)
    ok = standing & (at >= -12).all(1) & (at < size + 12).all(1)
    inner = np.clip(at, 0, size - 1)
    ok &= (blocked[inner[:, 1], inner[:, 0]] < 100) & (layers.roof[inner[:, 1], inner[:, 0]] == 0)
    growth = 1 + np.where(trees.height_m < 15, 0.05, 0.02) * season.years
    radius_px = trees.radius_m * growth**0.6 / grid.gsd_m
    height = trees.height_m * growth * np.where(trees.conifer, 1.0, season.bare_height)
    half_steps = np.clip(np.round(radius_px * 2), 2, 40).astype(int)
    for i in np.flatnonzero(ok):
        conifer = bool(trees.conifer[i])
        profile, shade = _crown(int(half_steps[i]), conifer, int(trees.tone[i] * 997) % VARIANTS, season.leaf_on or conifer)
        reach = profile.shape[0] // 2
        x0, y0 = at[i, 0] - reach, at[i, 1] - reach
        left, top, right, bottom = max(0, -x0), max(0, -y0), min(2 * reach + 1, size - x0), min(2 * reach + 1, size - y0)
        if right <= left or bottom <= top:
            continue
        window = (slice(y0 + top, y0 + bottom), slice(x0 + left, x0 + right))
        part = (slice(top, bottom), slice(left, right))
        crown = profile[part] * np.float32(height[i])
        higher = crown > layers.height_m[window]
        layers.height_m[window][higher] = crown[higher]
        layers.tree[window][higher] = i
        layers.shade[window][higher] = shade[part][higher]
        layers.roof[window][higher] = 0


@lru_cache(maxsize=2048)
def _crown(half_steps: int, conifer: bool, variant: int, dense: bool) -> tuple[Raster, NDArray[np.uint8]]:
    """Height profile (share of the tree's height, 0 outside) and shade of a crown of a radius in half pixels."""
    rng = np.random.default_rng([half_steps, conifer, variant])
    radius = half_steps / 2
    reach = int(np.ceil(radius * 1.25)) + 1
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1].astype(np.float32)
    angle = np.arctan2(y, x)
    edge = np.ones_like(x)
    for order in (2, 3, 5):
        edge += (0.05 if conifer else 0.13 / order**0.5) * np.sin(order * angle + rng.uniform(0, 6.3))
    rho = np.hypot(x, y) / (radius * edge)
    lumps = rng.standard_normal(x.shape)
    if conifer:
        profile = 0.15 + 0.85 * np.clip(1 - rho, 0, 1) ** 0.9
        shade = 128 * (1 + 0.10 * lumps)
    else:
        dome = np.sqrt(np.clip(1 - rho * rho, 0, 1))
        profile = 0.30 + 0.70 * dome * (1 + 0.09 * lumps)
        shade = 128 * (1 + (0.09 if dense else 0.07) * lumps)
    profile = np.where(rho < 1, np.clip(profile, 0.05, 1.15), 0)
    return profile.astype(np.float32), np.clip(shade, 40, 250).astype(np.uint8)


def _stamp_roof(grid: Grid, layers: Objects, building: Building) -> None:
    centre = grid.pix(building.center_m[None])[0]
    reach = int(np.hypot(building.length_m, building.width_m) / 2 / grid.gsd_m) + 2
    x0, y0 = int(np.round(centre[0])) - reach, int(np.round(centre[1])) - reach
    x1, y1 = min(x0 + 2 * reach + 1, grid.size_px), min(y0 + 2 * reach + 1, grid.size_px)
    x0, y0 = max(0, x0), max(0, y0)
    if x1 <= x0 or y1 <= y0:
        return
    y, x = np.mgrid[y0:y1, x0:x1]
    dx, dy = (x - centre[0]) * grid.gsd_m, (y - centre[1]) * grid.gsd_m
    c, s = np.cos(building.along_rad), np.sin(building.along_rad)
    along, across = dx * c + dy * s, -dx * s + dy * c
    under = (np.abs(along) < building.length_m / 2) & (np.abs(across) < building.width_m / 2)
    height = building.ridge_m - (building.ridge_m - building.eave_m) * np.abs(across) / (building.width_m / 2)
    window = (slice(y0, y1), slice(x0, x1))
    layers.height_m[window][under] = height[under]
    layers.roof[window][under] = 1 + int(building.tone * 254)
    layers.tree[window][under] = -1
