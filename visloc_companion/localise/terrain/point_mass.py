"""A sequential position from single soundings: the Bayes filter on a grid (Bucy & Senne 1971; Bergman 1999 for terrain).

The grid is of the error of the dead reckoning, not of places: flying moves it without interpolation, and only the growth of the
dead reckoning's uncertainty blurs it. State: error north and east on cells, and the height offset on levels; p (B, R, C) is the
probability of each. Deterministic, of any shape: ambiguity is kept until the terrain resolves it. The likelihood is the one-sided
mixture (noise.py). The start is flat (or a Gaussian that the caller asks for), so that what comes out is a measurement of the
terrain's alone, for the same filter as a patch's fix.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy.ndimage  # type: ignore[import-untyped]

from visloc_companion.localise.terrain.elevation import ElevationMap, Terrain
from visloc_companion.localise.terrain.noise import HeightNoise, expected_log_density, parts
from visloc_companion.types import FloatArray, Vec2, Vec3

BLUR_CELLS = 0.35
"""The grid is blurred when the uncertainty has grown by this much."""
FINER = 6.0
"""Cells of the grid to its 1-sigma below which the grid is laid anew, ..."""
SPAN_SIGMAS = 6.0
"""... reaching so far."""
WITHIN_CELL = 0.3
"""Places of a cell are this many cells (1-sigma, per axis) from its centre."""


WINDOW_MARGIN_M = 1500.0
"""Elevations are kept so far beyond the grid."""


@dataclass(frozen=True, slots=True)
class Region:
    """Where the filter begins: middle and half width (north, east) of the dead reckoning's error, and of the height offset."""

    middle_m: Vec3
    half_m: Vec3
    cell_m: float
    level_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Mean (3,) and covariance (3, 3) of the dead reckoning's error north, east and of its height's; `concentrated`: probability
    within three sigma (at least three cells) of the likeliest cell."""

    mean_m: FloatArray
    covariance_m2: FloatArray
    concentrated: float


class PointMassFilter:
    """The filter; `true place = dead reckoned place - error`, `true height = indicated height - offset`."""

    def __init__(self, elevation: ElevationMap, region: Region, noise: HeightNoise, gaussian_sigma_m: Vec3 | None = None) -> None:
        self._elevation, self._noise = elevation, noise
        self._axes = [_axis(m, h, s) for m, h, s in zip(region.middle_m, region.half_m, self._steps(region), strict=True)]
        north, east, offset = self._axes
        self.p: FloatArray = np.ones((len(offset), len(north), len(east)))
        if gaussian_sigma_m is not None:
            for axis, values, middle, sigma in zip((1, 2, 0), self._axes, region.middle_m, gaussian_sigma_m, strict=True):
                shape = [1, 1, 1]
                shape[axis] = len(values)
                self.p = self.p * np.exp(-0.5 * np.square((values - middle) / sigma)).reshape(shape)
        self.p /= self.p.sum()
        self._waiting_m2 = 0.0
        self._terrain: Terrain | None = None
        self._slope = 0.0

    @staticmethod
    def _steps(region: Region) -> Vec3:
        return region.cell_m, region.cell_m, region.level_m

    @property
    def cell_m(self) -> float:
        """Side of the grid's cells."""
        return float(self._axes[0][1] - self._axes[0][0])

    def carry(self, variance_m2: float) -> None:
        """The dead reckoning went on and became less certain by this much, each axis."""
        self._waiting_m2 += variance_m2
        sigma = math.sqrt(self._waiting_m2) / self.cell_m
        if sigma >= BLUR_CELLS:
            self.p = scipy.ndimage.gaussian_filter(self.p, (0, sigma, sigma), mode="constant", truncate=4.0)
            self.p /= self.p.sum()
            self._waiting_m2 = 0.0

    def observe(self, at_ne_m: Vec2, surface_amsl_m: float, independent: float) -> None:
        """One sounding: the surface's height by the indicated height, at a place by the dead reckoning.

        `independent` is how much of an independent sounding it counts for (spacing over correlation length, at most 1).
        """
        north, east, offset = self._axes
        rows, cols = np.meshgrid(at_ne_m[0] - north, at_ne_m[1] - east, indexing="ij")
        places = np.stack([rows, cols], -1).reshape(-1, 2)
        terrain = self._window(places)
        noise = self._blurred()
        difference = (surface_amsl_m - terrain.heights(places)).reshape(rows.shape)
        known = terrain.knows(places).reshape(rows.shape)
        log_density = parts(noise, difference[None] - offset[:, None, None]).log_density
        log_density = np.where(known, log_density, expected_log_density(noise))
        p = self.p * np.exp(independent * (log_density - log_density.max()))
        total = p.sum()
        if total > 0:
            self.p = p / total

    def estimate(self) -> Estimate:
        """Moments of the whole, and how much of it is one place."""
        north, east, _ = self._axes
        of = [self.p.sum((0, 2)), self.p.sum((0, 1)), self.p.sum((1, 2))]
        mean = np.array([float(w @ a) for w, a in zip(of, self._axes, strict=True)])
        dn, de, do = (a - m for a, m in zip(self._axes, mean, strict=True))
        plane = self.p.sum(0)
        ne = float(dn @ plane @ de)
        no, eo = float(do @ self.p.sum(2) @ dn), float(do @ self.p.sum(1) @ de)
        nn, ee, oo = (float(w @ np.square(d)) for w, d in zip(of, (dn, de, do), strict=True))
        covariance = np.array([[nn, ne, no], [ne, ee, eo], [no, eo, oo]])
        row, col = np.unravel_index(int(np.argmax(plane)), plane.shape)
        near = 3 * max(self.cell_m, self._core_sigma(plane, int(row), int(col)))
        inside = np.hypot((north - north[row])[:, None], (east - east[col])[None]) <= near
        return Estimate(mean, covariance, float(plane[inside].sum()))

    def lay_anew(self) -> bool:
        """A finer, smaller grid where the probability has gathered; False where that is not so yet."""
        estimate = self.estimate()
        sigma = math.sqrt(float(np.linalg.eigvalsh(estimate.covariance_m2[:2, :2])[-1]))
        finest = 0.25 * self._elevation.cell_m
        cell = max(finest, sigma / FINER * 2)
        if cell > 0.6 * self.cell_m:
            return False
        half = SPAN_SIGMAS * sigma + 2 * cell
        north, east, offset = self._axes
        new = [_axis(float(m), half, cell) for m in estimate.mean_m[:2]]
        at = np.meshgrid(
            np.arange(len(offset)), *((n - o[0]) / self.cell_m for n, o in zip(new, (north, east), strict=True)), indexing="ij"
        )
        self.p = np.maximum(scipy.ndimage.map_coordinates(self.p, at, order=1, mode="constant"), 0)
        self.p /= self.p.sum()
        self._axes = [*new, offset]
        return True

    def _blurred(self) -> HeightNoise:
        """The noise with what the ground rises within a cell of the grid."""
        return replace(self._noise, sigma_m=math.hypot(self._noise.sigma_m, WITHIN_CELL * self._slope * self.cell_m))

    def _core_sigma(self, plane: FloatArray, row: int, col: int) -> float:
        """1-sigma of the part of the plane above a tenth of its peak that lies within ten cells of it."""
        r, c = np.ogrid[: plane.shape[0], : plane.shape[1]]
        squared = np.asarray(np.square(r - row) + np.square(c - col), np.float64)
        weight = np.where((squared <= 100) & (plane >= 0.1 * plane[row, col]), plane, 0)
        return self.cell_m * math.sqrt(float((weight * squared).sum() / weight.sum()) / 2)

    def _window(self, places: FloatArray) -> Terrain:
        """Elevations about the grid, kept while the grid stays within them."""
        low, high = places.min(0), places.max(0)
        kept = self._terrain
        if kept is not None:
            last = kept.first_ne_m + (np.array(kept.known.shape) - 1) * kept.cell_m
            if (low >= kept.first_ne_m).all() and (high <= last).all():
                return kept
        middle, half = (low + high) / 2, (high - low) / 2 + WINDOW_MARGIN_M
        cell = self._elevation.cell_m
        self._terrain = self._elevation.window((float(middle[0]), float(middle[1])), (float(half[0]), float(half[1])), cell)
        self._slope = self._terrain.slope_rms()
        return self._terrain


def _axis(middle: float, half: float, step: float) -> FloatArray:
    n = max(1, math.ceil(half / step))
    return np.asarray(middle + np.arange(-n, n + 1) * step, dtype=np.float64)
