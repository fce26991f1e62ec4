"""A world for terrain navigation: ground truth of several roughnesses with lakes and forest, and an elevation model of it.

Ground: octaves of band-limited noise whose height falls with the wavelength to a power (fractional Brownian relief), scaled
by the class of the region: mountain, hills, rolling, flat (relief of 220, 60, 20, 8 m at 10 km). Lakes are level. Below the
grid's 20 m there is a periodic tile of detail. With a real elevation model the ground is that model plus the detail.

The elevation model that the vehicle carries: means over its cells, correlated errors (half of the variance over 60 m, half over
400 m; sigma 1.0, 1.5, 2.5 m for cells of 10, 20, 30 m; FABDEM, a bare-earth model of 30 m, has 2.5 m against control points in
North America), a shift of the whole (1 m an axis), 0.5 % voids.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.enums import Resampling

from visloc_companion.localise.terrain.elevation import ElevationMap
from visloc_companion.types import FloatArray

Raster = NDArray[np.float32]
GRID_M = 20.0
SIDE_M = 40_000.0
CLASSES = ("mountain", "hills", "rolling", "flat")
RELIEF_M = (220.0, 60.0, 20.0, 8.0)
"""1-sigma of the octave of 10 km."""
SHARES = (0.25, 0.35, 0.28, 0.12)
HURST = 0.8
LONGEST_M, N_OCTAVES = 10_000.0, 9
FOREST = (0.5, 0.5, 0.35, 0.2)
"""Share of forest by class."""
MOST_FOREST = 0.95
TALLEST_M = 25.0
SIGMA_M = {10.0: 1.0, 20.0: 1.5, 30.0: 2.5}
SHIFT_M = 1.0
DETAIL_PX, DETAIL_M = 512, 5.0


@dataclass(frozen=True, eq=False)
class World:
    """Rasters of GRID_M, row to the north, column to the east, cell (0, 0) at the origin."""

    ground_m: Raster
    region: NDArray[np.uint8]
    water: NDArray[np.bool_]
    canopy_m: Raster
    seen_through: Raster
    detail: Raster
    roughness_m: Raster

    @property
    def size_m(self) -> tuple[float, float]:
        """North and east."""
        rows, cols = self.ground_m.shape
        return rows * GRID_M, cols * GRID_M

    def ground(self, ne_m: FloatArray) -> FloatArray:
        """(N,) height of the ground."""
        at = ne_m / GRID_M
        return _looked_up(self.ground_m, at, cv2.INTER_CUBIC) + _looked_up(self.roughness_m, at) * _wrapped(self.detail, ne_m)

    def surface(self, ne_m: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, NDArray[np.bool_]]:
        """(N,) height of what a beam meets, and whether it comes back (not from water)."""
        at = ne_m / GRID_M
        crown = _looked_up(self.canopy_m, at, cv2.INTER_NEAREST) * (0.75 + 0.25 * rng.random(len(ne_m)))
        through = rng.random(len(ne_m)) < _looked_up(self.seen_through, at, cv2.INTER_NEAREST)
        wet = _looked_up(self.water.astype(np.float32), at, cv2.INTER_NEAREST) > 0.5
        return self.ground(ne_m) + np.where(through, 0, crown), ~wet

    def class_at(self, ne_m: FloatArray) -> list[str]:
        """Class of each place; water counts as flat."""
        rows, cols = np.clip(np.rint(ne_m / GRID_M).astype(int), 0, np.array(self.region.shape) - 1).T
        return [CLASSES[k] for k in self.region[rows, cols]]


def make_world(seed: int, dem: Path | None = None, forest: float = 1.0) -> World:
    """The world of a seed, over a real elevation model where one is given; `forest` times as much of it is wooded."""
    rng = np.random.default_rng([seed, 1])
    if dem is None:
        n = round(SIDE_M / GRID_M)
        ground, region, water = _fractal(rng, n)
    else:
        ground = _real(dem)
        region, water = _classified(ground), np.zeros(ground.shape, np.bool_)
    shape = ground.shape
    forest_share = np.minimum(np.array(FOREST, np.float32) * np.float32(forest), MOST_FOREST)[region]
    rank = _ranked(smooth(rng, shape, 350.0) + 0.5 * smooth(rng, shape, 90.0))
    wooded = (rank < forest_share) & ~water
    tall = np.clip(13 + 6 * smooth(rng, shape, 600.0) + 2 * smooth(rng, shape, 40.0), 3, TALLEST_M)
    through = np.where(wooded, np.clip(0.15 + 0.1 * smooth(rng, shape, 250.0), 0.01, 0.4), 1.0)
    roughness = np.where(water, 0, np.array([0.8, 0.6, 0.4, 0.3], np.float32)[region])
    detail = smooth(rng, (DETAIL_PX, DETAIL_PX), 15.0, DETAIL_M)
    canopy = np.where(wooded, tall, 0).astype(np.float32)
    return World(ground, region, water, canopy, through.astype(np.float32), detail, roughness.astype(np.float32))


def elevation_model(world: World, cell_m: float, seed: int, sigma_m: float | None = None) -> ElevationMap:
    """What the vehicle carries (module docstring)."""
    rng = np.random.default_rng([seed, 2])
    sigma = SIGMA_M[cell_m] if sigma_m is None else sigma_m
    rows, cols = (int(s // cell_m) - 1 for s in world.size_m)
    shift = rng.normal(0, SHIFT_M, 2)
    heights = np.zeros((rows, cols), np.float32)
    east = np.arange(cols) * cell_m
    for row in range(rows):  # means of four samples a cell, a row at a time
        samples = []
        for dn, de in ((-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)):
            ne = np.column_stack([np.full(cols, (row + dn) * cell_m), east + de * cell_m]) + shift
            samples.append(world.ground(ne))
        heights[row] = np.mean(samples, 0)
    error = smooth(rng, heights.shape, 60.0, cell_m) + smooth(rng, heights.shape, 400.0, cell_m)
    heights += np.float32(sigma / np.sqrt(2)) * error
    heights[_ranked(smooth(rng, heights.shape, 150.0, cell_m)) < 0.005] = np.nan
    return ElevationMap(heights, np.array([[0.0, cell_m, 0.0], [cell_m, 0.0, 0.0]]), sigma, SHIFT_M)


def smooth(rng: np.random.Generator, shape: tuple[int, int], length_m: float, cell_m: float = GRID_M) -> Raster:
    """Periodic Gaussian noise of unit spread, correlated over a length (autocorrelation 1/e there)."""
    return _filtered(rng, shape, lambda f: np.exp(-np.square(np.pi * f * length_m / cell_m) / 2))


def _fractal(rng: np.random.Generator, n: int) -> tuple[Raster, NDArray[np.uint8], NDArray[np.bool_]]:
    rank = _ordered(smooth(rng, (n, n), 7000.0))
    edges = np.cumsum(SHARES)
    region = np.searchsorted(edges[:-1], rank).astype(np.uint8)
    centres = edges - np.array(SHARES) / 2
    scale = np.exp(np.interp(rank, centres, np.log(RELIEF_M))).astype(np.float32)
    scale = cv2.GaussianBlur(scale, (0, 0), 1000 / GRID_M, borderType=cv2.BORDER_REFLECT)
    ground = np.full((n, n), 400.0, np.float32)
    for octave in range(N_OCTAVES):
        length = LONGEST_M / 2**octave
        if length < 2 * GRID_M:
            break
        ground += scale * np.float32((length / LONGEST_M) ** HURST) * _band(rng, (n, n), length)
    water = np.zeros((n, n), np.bool_)
    _flood(rng, ground, water)
    region[water] = len(CLASSES) - 1
    return ground, region, water


def _flood(rng: np.random.Generator, ground: Raster, water: NDArray[np.bool_]) -> None:
    """Forty lakes with ragged shores, level at the lowest ground in them; the ground about them leads down to the shore."""
    n = len(ground)
    ragged = smooth(rng, ground.shape, 500.0)
    for _ in range(40):
        row, col = rng.integers(n // 20, n - n // 20, 2)
        radius = rng.uniform(300, 1500) / GRID_M
        reach = int(radius * 1.6 + 600 / GRID_M)
        window = tuple(slice(max(0, k - reach), min(n, k + reach)) for k in (row, col))
        r, c = np.ogrid[window]
        outside = (np.hypot(r - row, c - col) - radius * (1 + 0.3 * ragged[window])) * GRID_M
        level = np.percentile(ground[window][outside < 0], 10) if (outside < 0).any() else 0.0
        rise = np.clip(outside / 500, 0, 1) ** 1.5
        ground[window] = (level + (ground[window] - level) * rise).astype(np.float32)
        water[window] |= outside < 0


def _real(path: Path) -> Raster:
    """A real model on GRID_M, voids filled with the median, first row southernmost. Needs a CRS in metres."""
    with rasterio.open(path) as dataset:
        scale = abs(dataset.transform.a) / GRID_M
        shape = (round(dataset.height * scale), round(dataset.width * scale))
        values = dataset.read(1, out_shape=shape, resampling=Resampling.cubic, masked=True).astype(np.float32)
    return np.ascontiguousarray(values.filled(np.float32(np.ma.median(values)))[::-1])


def _classified(ground: Raster) -> NDArray[np.uint8]:
    """By the relief within 1.5 km: the classes' own is 0.35 of their octave of 10 km."""
    mean = cv2.GaussianBlur(ground, (0, 0), 750 / GRID_M)
    relief = np.sqrt(np.maximum(cv2.GaussianBlur(np.square(ground - mean), (0, 0), 750 / GRID_M), 0))
    bounds = 0.35 * np.sqrt(np.array(RELIEF_M[:-1]) * np.array(RELIEF_M[1:]))
    return np.asarray((relief[..., None] < bounds).sum(-1), np.uint8)


def _band(rng: np.random.Generator, shape: tuple[int, int], length_m: float) -> Raster:
    """Periodic noise of unit spread about one wavelength."""
    return _filtered(rng, shape, lambda f: np.exp(-np.square(np.log2(np.maximum(f, 1e-9) * length_m / GRID_M)) * 2))


def _filtered(rng: np.random.Generator, shape: tuple[int, int], gain: object) -> Raster:
    f = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None])
    spectrum = np.fft.rfft2(rng.standard_normal(shape, dtype=np.float32)) * gain(f)  # type: ignore[operator]
    spectrum[0, 0] = 0
    field = np.fft.irfft2(spectrum, s=shape)
    return np.asarray(field / field.std(), np.float32)


def _ranked(field: Raster) -> Raster:
    """Share of cells that are lower (normal noise: by its distribution)."""
    z = (field - field.mean()) / field.std()
    return np.asarray(1 / (1 + np.exp(-1.5976 * z - 0.07056 * z**3)), np.float32)


def _ordered(field: Raster) -> Raster:
    """Share of cells that are lower, exactly."""
    rank = np.empty(field.size, np.float32)
    rank[np.argsort(field, axis=None)] = np.arange(field.size, dtype=np.float32) / field.size
    return rank.reshape(field.shape)


def _looked_up(raster: Raster, at_rc: FloatArray, how: int = cv2.INTER_LINEAR) -> FloatArray:
    """(N,) values at (N, 2) row, column."""
    n = len(at_rc)
    width = min(n, 4096) or 1
    padded = np.zeros((-(-n // width) * width, 2), np.float32)
    padded[:n] = at_rc
    rows, cols = (padded[:, k].reshape(-1, width) for k in (0, 1))
    found = cv2.remap(raster, np.ascontiguousarray(cols), np.ascontiguousarray(rows), how, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found.reshape(-1)[:n], np.float64)


def _wrapped(tile: Raster, ne_m: FloatArray) -> FloatArray:
    return _looked_up(tile, np.mod(ne_m / DETAIL_M, DETAIL_PX - 1))
