"""How a cloud was sampled: which points are copies, which coordinates lie on a lattice, and what rounding leaves unknown.

A raster has one sample to a node of its lattice, and its heights were taken there. Scattered points that were rounded lie several
to a node. Nothing in whole metres tells whether they are the nearest ones or those below: all points may be off by half a step,
the same way. Coordinates in float32 are the nearest, and of them only northings have steps to be seen (0.5 m at 5,000,000 m).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from visloc_companion.types import FloatArray

LEAST_STEP_M = 0.2
"""Half of a finer step is no more than the floor of what is claimed."""
SAMPLE = 2000
"""Values by which nearly all clouds are seen to lie on no lattice; drawn by the golden ratio, not row by row of a raster."""
GOLDEN = 0.6180339887498949
ASIDE = 0.01
"""A value so far (in steps) from a node lies on it."""
SHARED = 0.01
"""A raster has a smaller share of points that are not the only one of their node, as where two tiles meet."""
EVEN = (0.7548776662466927, 0.5698402909980532)
"""Powers of the inverse of the plastic number: their multiples fill a square evenly."""
MIX = (*EVEN, 0.3090169943749474)
"""Irrational: points whose sums by these are alike are alike."""


@dataclass(frozen=True, slots=True, eq=False)
class Sampling:
    """`step_m` (3,) of the lattice on which east, north and up lie, 0 for none; `raster`: its nodes hold a point each."""

    step_m: FloatArray
    raster: bool

    @property
    def spacing_m(self) -> float:
        """Of a raster, the larger one; 0 for scattered points."""
        return float(self.step_m[:2].max()) if self.raster else 0.0

    @property
    def unknown_m2(self) -> FloatArray:
        """(3,) variance of what all points may be off by together, uniformly within half a step; horizontally that of scattered
        points whose east and north are rounded both."""
        both = bool(self.step_m[:2].all()) and not self.raster
        return np.asarray(np.square(self.step_m) / 12 * [both, both, True], dtype=np.float64)

    def spread(self, points_m: FloatArray) -> FloatArray:
        """The points (N, 3); scattered ones that were rounded spread evenly over their step again, east and north.

        On nodes, cells of another size would hold one row of them here and two there, and the highest of a node's points stands
        for all of it. The sequence is that of Roberts (2018), by the points' order.
        """
        if self.raster or not self.step_m[:2].any():
            return points_m
        spread, number = points_m.copy(), np.arange(len(points_m))
        for axis in range(2):
            spread[:, axis] += self.step_m[axis] * (np.mod(number * EVEN[axis], 1) - 0.5)
        return spread


def sampling_of(points_m: FloatArray) -> Sampling:
    """Of points (N, 3)."""
    steps = np.array([_lattice_step_m(points_m[:, axis]) for axis in range(3)])
    return Sampling(steps, bool(steps[:2].all()) and not _share_nodes(points_m))


def distinct(points_m: FloatArray) -> int:
    """How many of the points (N, K), K up to 3, are no copies of another."""
    mixed = points_m[:, 0] * MIX[0]
    for axis in range(1, points_m.shape[1]):
        mixed = mixed + points_m[:, axis] * MIX[axis]
    return len(np.unique(mixed))


def _share_nodes(points_m: FloatArray) -> bool:
    return distinct(points_m[:, :2]) < (1 - SHARED) * distinct(points_m)


def _lattice_step_m(along_m: FloatArray) -> float:
    some = along_m[(np.arange(min(SAMPLE, len(along_m))) * GOLDEN % 1 * len(along_m)).astype(np.int64)]
    return _step_m(along_m) if _step_m(some) else 0.0


def _step_m(along_m: FloatArray) -> float:
    values = np.unique(along_m)
    gaps = np.diff(values)
    gaps = gaps[gaps > ASIDE * LEAST_STEP_M]  # less is the same value by another sum
    if not len(gaps) or float(gaps.min()) < LEAST_STEP_M:
        return 0.0
    span = float(values[-1] - values[0])
    step = span / round(span / float(gaps.min()))
    aside = (values - values[0]) / step
    return step if float(np.abs(aside - np.rint(aside)).max()) < ASIDE else 0.0
