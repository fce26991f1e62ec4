"""Refinement of a similarity on two height maps: robust least squares with the prior's knowledge, on relief and heights in turn.

Gauss-Newton on the vertical distance of the source's cells to the reference's surface (least-squares matching of surfaces: Gruen
and Akca 2005; vertical residuals: Nuth and Kääb 2011). Shift, heading and scale come from the relief alone, which says where
things are; height, tilt and the bowl that a badly calibrated camera bends a cloud into come from the heights: on a slope a wrong
tilt or bowl would otherwise be paid for by a shift. Cells that differ by much more than most (felled, built, grown, outliers)
lose their weight (Geman-McClure). Heading, scale, tilt and bowl are held by their priors where the surface says nothing of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.base import Float32Array, Mask
from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.height_map import HeightMap
from visloc_companion.localise.registration.similarity import moved, scale_of, tilt_of, turned, with_linear, yaw_of
from visloc_companion.types import FloatArray

SIGMA_BOWL_M = 0.5
"""1-sigma of the bowl: height of its rim's middle over its own mean."""
WEIGHT_SIGMAS = 2.0
"""Height differences, in robust deviations of all, at which a cell's weight is a quarter."""
LEAST_SIGMA_M = 0.1
ALIKE = 16.0
"""So many cells count as one: their differences are alike. Errors were 4 times those of independent cells (places fitted on)."""
ROW = 1024
"""Places are looked up in rows of so many: OpenCV takes no wider ones than 32,767."""
FEWEST_CELLS = 30
SMALL_STEP_M = 2e-3
LEAST_PRIOR, TINY = 1e-6, 1e-9
"""Least 1-sigma of a prior; information that keeps the equations of a plane solvable (1-sigma of 30 km)."""
IN_REFERENCE = 0.7
"""Interpolated `known` from which a place counts as on the reference."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A reference for refinement: (H, W, 4) height, its slope to the east and north, known or not; of `heights`."""

    layers: Float32Array
    heights: HeightMap

    def at(self, xy_m: FloatArray) -> Float32Array:
        """(N, 4) the layers at places (N, 2)."""
        n, rows = len(xy_m), -(-len(xy_m) // ROW)
        cells = np.full((rows * ROW, 2), -10, np.float32)
        cells[:n] = self.heights.cells_of(xy_m)
        u, v = np.ascontiguousarray(cells.T).reshape(2, rows, ROW)
        found = cv2.remap(self.layers, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT)
        return np.asarray(found.reshape(-1, 4)[:n], dtype=np.float32)

    @staticmethod
    def holds(layers: Float32Array) -> Mask:
        """(N,) which of the places are on the surface."""
        return np.asarray(layers[:, 3] > IN_REFERENCE)


@dataclass(frozen=True, slots=True, eq=False)
class SourceCells:
    """The source's known cells as points (N, 3), their relief (N,), the height (N,) of a bowl of 1 m at each, and
    where they are in the map's `shape`."""

    points_m: FloatArray
    relief_m: FloatArray
    centre_m: FloatArray
    bowl: FloatArray
    rows: NDArray[np.int64]
    cols: NDArray[np.int64]
    shape: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """`T` (4, 4), `bowl_m`; formal covariances of what is `placed` (4, 4: east, north,
    heading, scale) and `raised` (4, 4: up, tilt about east and north, bowl); robust deviations of either kind of differences."""

    T: FloatArray
    bowl_m: float
    placed: FloatArray
    raised: FloatArray
    relief_sigma_m: float
    height_sigma_m: float


def surface_of(heights: HeightMap) -> Surface:
    """Slopes by central differences."""
    h, step = heights.height_m, np.float32(0.5 / heights.cell_m)
    east, north = np.zeros_like(h), np.zeros_like(h)
    east[:, 1:-1] = (h[:, 2:] - h[:, :-2]) * step
    north[1:-1] = (h[2:] - h[:-2]) * step
    return Surface(np.stack([h, east, north, heights.known.astype(np.float32)], -1), heights)


def cells_of(heights: HeightMap, relief: HeightMap, centre_m: FloatArray) -> SourceCells:
    """The known cells of the source's map, which are those of its relief."""
    rows, cols = np.nonzero(heights.known)
    xy = np.column_stack([cols, rows]) * heights.cell_m + heights.corner_m + heights.cell_m / 2
    points = np.column_stack([xy, heights.height_m[rows, cols].astype(np.float64)])
    out = points[:, :2] - centre_m[:2]
    squared = (out**2).sum(1)
    bowl = squared / max(2 * float(squared.mean()), 1e-9)
    bowl -= float(bowl.mean())
    own = relief.height_m[rows, cols].astype(np.float64)
    return SourceCells(points, own, centre_m, bowl, rows, cols, heights.known.shape)


def refine(
    source: SourceCells, surface: Surface, relief: Surface, start: FloatArray, prior: RegistrationPrior, steps: int
) -> Refined | None:
    """Refined from a start in at most so many steps (0: looked at as it is); None where too few cells lie on the reference."""
    T, bowl_m = start, 0.0
    for left in range(steps, -1, -1):
        raised = raising(source, surface, T, bowl_m, prior)
        if raised is None:
            return None
        up, tilt_x, tilt_y, more = raised.step()
        if left:
            T, bowl_m = stepped(T, source.centre_m, np.array([0, 0, up]), (tilt_x, tilt_y, 0.0), 0.0), bowl_m + more
        placed = _placing(source, relief, T, prior)
        if placed is None:
            return None
        east, north, yaw, scale = placed.step()
        if not left or max(abs(east), abs(north), abs(up)) < SMALL_STEP_M:
            return Refined(T, bowl_m, placed.covariance(), raised.covariance(), placed.sigma_m, raised.sigma_m)
        T = stepped(T, source.centre_m, np.array([east, north, 0]), (0.0, 0.0, yaw), scale)
    return None


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """Normal equations of four parameters: jacobian^T W jacobian and - jacobian^T W residual, the prior's precision and wish."""

    information: FloatArray
    pull: FloatArray
    sigma_m: float
    precision: FloatArray
    wish: FloatArray

    def step(self) -> tuple[float, float, float, float]:
        """The Gauss-Newton step."""
        found = np.linalg.solve(self._held(), self.pull / (ALIKE * self.sigma_m**2) + self.precision * self.wish)
        return float(found[0]), float(found[1]), float(found[2]), float(found[3])

    def covariance(self) -> FloatArray:
        """(4, 4) with what the prior knows."""
        return np.asarray(np.linalg.inv(self._held()), dtype=np.float64)

    def _held(self) -> FloatArray:
        held = self.information / (ALIKE * self.sigma_m**2) + np.diag(self.precision + TINY)
        return np.asarray(held, dtype=np.float64)


def differences(source: SourceCells, surface: Surface, T: FloatArray, bowl_m: float) -> tuple[Mask, FloatArray, FloatArray]:
    """The cells used (N,), their differences of height (n,) and how these change (n, 4) with east, north, heading, scale."""
    at = moved(T, source.points_m + np.outer(bowl_m * source.bowl, [0, 0, 1]))
    layers = surface.at(at[:, :2])
    used = surface.holds(layers)
    u, v, w = (at[used] - moved(T, source.centre_m)).T
    height, east, north = (layers[used, k].astype(np.float64) for k in range(3))
    jacobian = np.column_stack([east, north, north * u - east * v, east * u + north * v - w])
    return used, np.asarray(height - at[used, 2]), jacobian


def prior_of_placing(T: FloatArray, prior: RegistrationPrior) -> tuple[FloatArray, FloatArray]:
    """Precision of east, north, heading, scale, and their distance from what is expected. Of the place itself: none."""
    precision = _precision(np.inf, np.inf, prior.sigma_yaw_rad, prior.sigma_scale)
    return precision, -np.array([0.0, 0.0, yaw_of(T), np.log(scale_of(T))])


def robust(residual: FloatArray, least_m: float) -> tuple[float, FloatArray]:
    """Robust deviation of the residuals (N,), and their weights (N,) of Geman and McClure about their median."""
    off = residual - float(np.median(residual))
    sigma = max(LEAST_SIGMA_M, least_m, 1.4826 * float(np.median(np.abs(off))))
    return sigma, np.asarray(1 / np.square(1 + np.square(off / (WEIGHT_SIGMAS * sigma))))


def _placing(source: SourceCells, relief: Surface, T: FloatArray, prior: RegistrationPrior) -> Equations | None:
    """Equations of east, north, heading, scale on the relief."""
    at = moved(T, source.points_m)
    layers = relief.at(at[:, :2])
    used = relief.holds(layers)
    if used.sum() < FEWEST_CELLS:
        return None
    u, v, _ = (at[used] - moved(T, source.centre_m)).T
    own = source.relief_m[used] * scale_of(T)
    height, east, north = (layers[used, k].astype(np.float64) for k in range(3))
    jacobian = np.column_stack([east, north, north * u - east * v, east * u + north * v - own])
    return _weighted(jacobian, height - own, *prior_of_placing(T, prior), 0.0)


def raising(source: SourceCells, surface: Surface, T: FloatArray, bowl_m: float, prior: RegistrationPrior) -> Equations | None:
    """Equations of up, tilt about east, tilt about north, bowl on the heights."""
    at = moved(T, source.points_m + np.outer(bowl_m * source.bowl, [0, 0, 1]))
    layers = surface.at(at[:, :2])
    used = surface.holds(layers)
    if used.sum() < FEWEST_CELLS:
        return None
    u, v, w = (at[used] - moved(T, source.centre_m)).T
    height, east, north = (layers[used, k].astype(np.float64) for k in range(3))
    jacobian = np.column_stack([-np.ones_like(u), -north * w - v, east * w + u, -source.bowl[used]])
    precision = _precision(np.inf, prior.sigma_tilt_rad, prior.sigma_tilt_rad, SIGMA_BOWL_M)
    return _weighted(jacobian, height - at[used, 2], precision, -np.array([0, *tilt_of(T), bowl_m]), prior.sigma_growth_m)


def _precision(*sigmas: float) -> FloatArray:
    return np.asarray(1 / np.square(np.maximum(sigmas, LEAST_PRIOR)), dtype=np.float64)


def _weighted(jacobian: FloatArray, residual: FloatArray, precision: FloatArray, wish: FloatArray, least_m: float) -> Equations:
    sigma, weight = robust(residual, least_m)
    weighted = jacobian * weight[:, None]
    return Equations(weighted.T @ jacobian, -weighted.T @ residual, sigma, precision, wish)


def stepped(
    T: FloatArray, centre_m: FloatArray, shift_m: FloatArray, turn: tuple[float, float, float], log_scale: float
) -> FloatArray:
    """T, then turned, scaled and shifted by a step about the moved centre."""
    linear = np.exp(log_scale) * turned(*turn) @ T[:3, :3]
    return with_linear(np.asarray(linear, dtype=np.float64), centre_m, moved(T, centre_m) + shift_m)
