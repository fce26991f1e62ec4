"""Refinement of a similarity on two height maps: robust least squares with the prior's knowledge, on relief and heights in turn.

Gauss-Newton on the vertical distance of the source's cells to the reference's surface (least-squares matching of surfaces: Gruen
and Akca 2005; vertical residuals: Nuth and Kääb 2011). Shift, heading and scale come from the relief alone, which says where
things are; height, tilt and the bowl that a badly calibrated camera bends a cloud into come from the heights: on a slope a wrong
tilt or bowl would otherwise be paid for by a shift. Cells that differ by much more than most (felled, built, grown, outliers)
lose their weight (Geman-McClure). Heading, scale, tilt and bowl are held by their priors where the surface says nothing of them.

How heights change with the scale is taken from the reference's, not from the source's own, which are noisier: their noise would
stand on both sides of the equations and be explained by a smaller scale (errors in variables; the reference is the instrument).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from visloc_companion.localise.features.base import Mask
from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.similarity import moved, scale_of, tilt_of, turned, with_linear, yaw_of
from visloc_companion.localise.registration.surfaces import SourceCells, Surface, met
from visloc_companion.types import FloatArray

SIGMA_BOWL_M = 0.5
"""1-sigma of the bowl: height of its rim's middle over its own mean."""
WEIGHT_SIGMAS = 2.0
"""Height differences, in robust deviations of all, at which a cell's weight is a quarter."""
LEAST_SIGMA_M = 0.1
ALIKE = 16.0
"""So many cells count as one: their differences are alike. Errors were 4 times those of independent cells (places fitted on)."""
FEWEST_CELLS = 30
SMALL_STEP_M = 2e-3
LEAST_PRIOR, TINY = 1e-6, 1e-9
"""Least 1-sigma of a prior; information that keeps the equations of a plane solvable (1-sigma of 30 km)."""


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """`T` (4, 4), `bowl_m`; formal covariances of what is `placed` (4, 4: east, north,
    heading, scale) and `raised` (4, 4: up, tilt about east and north, bowl); robust deviation of the differences in height."""

    T: FloatArray
    bowl_m: float
    placed: FloatArray
    raised: FloatArray
    height_sigma_m: float


def refine(
    source: SourceCells, surface: Surface, relief: Surface, start: FloatArray, prior: RegistrationPrior, steps: int
) -> Refined | None:
    """Refined from a start in at most so many steps (0: looked at as it is); None where too few cells lie on the reference."""
    T, bowl_m = start, 0.0
    for left in range(steps, -1, -1):
        level = levelled(source, surface, T, bowl_m, prior, left > 0)
        placed = None if level is None else _placing(source, relief, level.T, prior)
        if level is None or placed is None:
            return None
        T, bowl_m = level.T, level.bowl_m
        east, north, yaw, scale = placed.step()
        if not left or max(abs(east), abs(north), abs(level.up_m)) < SMALL_STEP_M:
            return Refined(T, bowl_m, placed.covariance(), level.raised.covariance(), level.raised.sigma_m)
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


@dataclass(frozen=True, slots=True, eq=False)
class Levelled:
    """`T` and `bowl_m` after a step of height, tilt and bowl; the step's `up_m` and its equations."""

    T: FloatArray
    bowl_m: float
    up_m: float
    raised: Equations


def levelled(
    source: SourceCells, surface: Surface, T: FloatArray, bowl_m: float, prior: RegistrationPrior, moves: bool
) -> Levelled | None:
    """One step of height, tilt and bowl, taken where it `moves`; None where too few cells lie on the reference."""
    raised = _raising(source, surface, T, bowl_m, prior)
    if raised is None:
        return None
    up, tilt_x, tilt_y, more = raised.step()
    if not moves:
        return Levelled(T, bowl_m, up, raised)
    T = stepped(T, source.centre_m, np.array([0, 0, up]), (tilt_x, tilt_y, 0.0), 0.0)
    return Levelled(T, bowl_m + more, up, raised)


def differences(source: SourceCells, surface: Surface, T: FloatArray, bowl_m: float) -> tuple[Mask, FloatArray, FloatArray]:
    """The cells used (N,), their differences of height (n,) and how these change (n, 4) with east, north, heading, scale."""
    on = met(source, surface, T, bowl_m)
    u, v, w = on.out_m.T
    surface_w = w + on.height_m - on.at_m[:, 2]
    jacobian = np.column_stack([on.east, on.north, on.north * u - on.east * v, on.east * u + on.north * v - surface_w])
    return on.used, np.asarray(on.height_m - on.at_m[:, 2]), jacobian


def prior_of_placing(T: FloatArray, prior: RegistrationPrior) -> tuple[FloatArray, FloatArray]:
    """Precision of east, north, heading, scale, and their distance from what is expected. Of the place itself: none."""
    precision = _precision(np.inf, np.inf, prior.sigma_yaw_rad, prior.sigma_scale)
    return precision, -np.array([0.0, 0.0, yaw_of(T), np.log(scale_of(T))])


def robust(residual: FloatArray, least_m: float, counts: FloatArray | None = None, wide: float = 1.0) -> tuple[float, FloatArray]:
    """Robust deviation of the residuals (N,), and their weights (N,) of Geman and McClure about their median.

    `counts` (N,): how much each residual counts in the deviation, alike where it is missing. `wide`: how much wider the weights
    are than usual.
    """
    off = np.abs(residual - _median(residual))
    middle = _median(off) if counts is None else _weighted_median(off, counts)
    sigma = max(LEAST_SIGMA_M, least_m, 1.4826 * middle)
    return sigma, np.asarray(1 / np.square(1 + np.square(off / (WEIGHT_SIGMAS * wide * sigma))))


def _median(values: FloatArray) -> float:
    """np.median's of numbers (N,), which looks for NaN besides."""
    half = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, half)[half])
    low, high = np.partition(values, (half - 1, half))[half - 1 : half + 1]
    return float(low + high) / 2


def _weighted_median(values: FloatArray, weight: FloatArray) -> float:
    order = np.argsort(values)
    up_to = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(up_to, up_to[-1] / 2)])


def _placing(source: SourceCells, relief: Surface, T: FloatArray, prior: RegistrationPrior) -> Equations | None:
    """Equations of east, north, heading, scale on the relief."""
    on = met(source, relief, T)
    if len(on.at_m) < FEWEST_CELLS:
        return None
    u, v, _ = on.out_m.T
    own = source.relief_m[on.used] * scale_of(T)
    jacobian = np.column_stack([on.east, on.north, on.north * u - on.east * v, on.east * u + on.north * v - on.height_m])
    return _weighted(jacobian, on.height_m - own, *prior_of_placing(T, prior), 0.0)


def _raising(source: SourceCells, surface: Surface, T: FloatArray, bowl_m: float, prior: RegistrationPrior) -> Equations | None:
    """Equations of up, tilt about east, tilt about north, bowl on the heights."""
    on = met(source, surface, T, bowl_m)
    if len(on.at_m) < FEWEST_CELLS:
        return None
    u, v, w = on.out_m.T
    jacobian = np.column_stack([-np.ones_like(u), -on.north * w - v, on.east * w + u, -source.bowl[on.used]])
    precision = _precision(np.inf, prior.sigma_tilt_rad, prior.sigma_tilt_rad, SIGMA_BOWL_M)
    wish = -np.array([0, *tilt_of(T), bowl_m])
    return _weighted(jacobian, on.height_m - on.at_m[:, 2], precision, wish, prior.sigma_growth_m)


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
