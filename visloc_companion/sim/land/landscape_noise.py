"""Noise for the procedural landscape: smooth lattice noise on rasters and sums of waves on points, both from a seed."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.types import FloatArray

Raster = NDArray[np.float32]


def rng_of(seed: int, purpose: str) -> np.random.Generator:
    """A generator of its own for each purpose, so that a change in one part of the world leaves the others as they are."""
    return np.random.default_rng([seed, zlib.crc32(purpose.encode())])


def smooth_noise(rng: np.random.Generator, size_px: int, cell_px: float, anisotropy: float = 1.0) -> Raster:
    """(size, size) noise of zero mean and about unit spread, smooth over `cell_px` (times `anisotropy` along the columns)."""
    cells_x = int(np.ceil(size_px / (cell_px * anisotropy))) + 4
    cells_y = int(np.ceil(size_px / cell_px)) + 4
    lattice = rng.standard_normal((cells_y, cells_x), dtype=np.float32)
    to_lattice = np.array([[1 / (cell_px * anisotropy), 0, 1.5], [0, 1 / cell_px, 1.5]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(lattice, to_lattice, (size_px, size_px), flags=flags) * 1.3, dtype=np.float32)


def fractal_noise(rng: np.random.Generator, size_px: int, cell_px: float, octaves: int, gain: float = 0.5) -> Raster:
    """Sum of octaves of smooth noise, each with half the cell and `gain` times the height; zero mean, about unit spread."""
    total = np.zeros((size_px, size_px), np.float32)
    weight, power = 1.0, 0.0
    for _ in range(octaves):
        if cell_px < 1.0:
            break
        total += np.float32(weight) * smooth_noise(rng, size_px, cell_px)
        power += weight * weight
        weight, cell_px = weight * gain, cell_px / 2
    return total / np.float32(np.sqrt(power))


@dataclass(frozen=True)
class Waves:
    """A smooth scalar field on the plane: a sum of sines with random directions, wavelengths and phases."""

    k_radpm: FloatArray
    phase_rad: FloatArray
    height: FloatArray

    @classmethod
    def random(cls, rng: np.random.Generator, n: int, wavelength_m: tuple[float, float], height: float) -> Waves:
        """`n` waves of wavelengths in a range; the field's standard deviation is `height`."""
        direction = rng.uniform(0, 2 * np.pi, n)
        k = 2 * np.pi / rng.uniform(*wavelength_m, n)
        heights = np.full(n, height * np.sqrt(2 / n))
        return cls(np.column_stack([k * np.cos(direction), k * np.sin(direction)]), rng.uniform(0, 2 * np.pi, n), heights)

    def __call__(self, points_m: FloatArray) -> FloatArray:
        """Values at (N, 2) points."""
        return np.asarray(np.sin(points_m @ self.k_radpm.T + self.phase_rad) @ self.height, dtype=np.float64)
