"""Clouds on which nothing tells one place from another, or only along one axis: what must be refused.

Written as .laz so that the shared tool makes cases of them as of any other cloud.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import laspy
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SIDE_M, DENSITY = 300.0, 3.0
TREE_EVERY_M, TREE_M, CROWN_M = 8.0, 9.0, 3.0


def write_bare_clouds(folder: Path, seed: int) -> Path:
    """One .laz of each kind in BARE; returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for k, (name, heights) in enumerate(BARE.items()):
        rng = np.random.default_rng([seed, k])
        xy = rng.uniform(0, SIDE_M, (int(DENSITY * SIDE_M**2), 2))
        las = laspy.LasData(laspy.LasHeader(point_format=0, version="1.2"))
        las.header.scales = np.full(3, 0.001)
        las.x, las.y, las.z = xy[:, 0], xy[:, 1], heights(rng, xy) + rng.normal(0, 0.03, len(xy))
        las.write(folder / f"{name}.laz")
    return folder


def water(_: np.random.Generator, xy: Array) -> Array:
    """A plane."""
    return np.zeros(len(xy))


def field(rng: np.random.Generator, xy: Array) -> Array:
    """Ploughed land: 4 cm of relief over some metres, on a slope of 1 %."""
    return _noise(rng, xy, 4.0, 0.04) + 0.01 * xy[:, 0]


def furrows(rng: np.random.Generator, xy: Array) -> Array:
    """Ridges of 0.3 m every 5 m that look the same everywhere."""
    return 0.15 * np.sin(2 * np.pi * (xy[:, 0] + 0.3 * xy[:, 1]) / 5.0) + _noise(rng, xy, 6.0, 0.02)


def tree_row(rng: np.random.Generator, xy: Array) -> Array:
    """A lawn and one row of trees alike, at equal distances."""
    off = np.abs((xy[:, 1] + TREE_EVERY_M / 2) % TREE_EVERY_M - TREE_EVERY_M / 2)
    crown = np.clip(1 - np.square(np.hypot(xy[:, 0] - SIDE_M / 2, off) / CROWN_M), 0, 1)
    return TREE_M * np.sqrt(crown) + _noise(rng, xy, 5.0, 0.03)


BARE: dict[str, Callable[[np.random.Generator, Array], Array]] = {
    "made_water": water,
    "made_field": field,
    "made_furrows": furrows,
    "made_tree_row": tree_row,
}


def _noise(rng: np.random.Generator, xy: Array, metres: float, deviation: float) -> Array:
    grid = cv2.GaussianBlur(rng.standard_normal((int(SIDE_M) + 2,) * 2), (0, 0), metres)
    column, row = xy.astype(int).T
    return np.asarray(grid[row, column] / grid.std() * deviation, dtype=np.float64)
