"""Covariance of an alignment whose residuals are alike over some way, from sums over cells of the window (Liang & Zeger 1986).

The formal covariance of Lucas-Kanade takes residuals for noise of one strength, the same all over the window and independent
beyond some pixels (descent.CORRELATED_PX). They are neither: half of a frame may be water that shows nothing of the map, and
along a shore or a field's border they have one sign. By how much each cell of the window pulls at the pose is added up; what
these sums scatter by is what the pull of all varies by, whatever the residuals are like within a cell ("sandwich" covariance,
White 1980).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise import align
from visloc_companion.localise.candidates.descent import CORRELATED_PX, Rectified, rectified
from visloc_companion.localise.candidates.frame_features import FrameFeatures
from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.mapped.open_ground import OpenGround
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid
from visloc_companion.localise.pose import PriorTerm
from visloc_companion.types import FloatArray

CELLS = 4
"""Along the longer side of a window: a moved line runs through some of them."""
FACTOR = 3.0
"""On the variance of the sums: cells along one line are no independent ones. Both were chosen on training rows of NAIP, worlds 60
to 65 and shores of worlds 50 to 52."""
UNKNOWNS = 7
"""Of the pose, and the gain."""


def excess_variance(
    frame: FrameFeatures,
    pose: CameraPose,
    grid: MapGrid,
    descent: align.Descent,
    prior: PriorTerm,
    ground: OpenGround | None = None,
) -> FloatArray:
    """(6, 6) variance of what residuals pull a pose by where a descent (descent.py) ended, beyond what its information takes it
    to be and in the same units; positive semidefinite, zero where cells pull no more than that.

    A, the information with the prior: then the pose's covariance is inv(A) + inv(A) excess inv(A).
    """
    raised = grid if ground is None else ground.on(grid)
    seen = rectified(frame, pose, raised)
    sums = align.map_sums(descent, raised, pose)
    step = align.gauss_newton_step(sums, seen.smooth, seen.weight, *prior.at(pose), CORRELATED_PX, ground)
    pulls, weight = _pulls(sums, step, seen, ground), seen.weight[:: sums.stride, :: sums.stride]
    number, n = _cells(weight.shape)
    summed = np.stack([np.bincount(number, pull, n) for pull in pulls])
    count = int(np.count_nonzero(np.bincount(number, weight.ravel(), n)))
    variance = summed @ summed.T * (FACTOR / step.noise**2 * count / max(count - UNKNOWNS, 1.0))
    if ground is not None and step.by_pose_m is not None:
        variance = variance + step.by_pose_m.T @ ground.information @ step.by_pose_m
    return _beyond(np.asarray(variance, dtype=np.float64), step.information)


def _beyond(variance: FloatArray, information: FloatArray) -> FloatArray:
    """By how much a variance (6, 6) is more than an information, in the directions in which it is."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, axes = np.linalg.eigh(information / np.outer(scale, scale))
    root = np.sqrt(np.maximum(values, 1e-9))
    whiten, colour = (axes / root).T / scale, scale[:, None] * axes * root
    times, directions = np.linalg.eigh(whiten @ variance @ whiten.T)
    colour = colour @ directions
    return np.asarray(colour * np.maximum(times - 1.0, 0.0) @ colour.T, dtype=np.float64)


def _pulls(sums: align.MapSums, step: align.Step, seen: Rectified, ground: OpenGround | None) -> FloatArray:
    """(6, P) by which the residual of each pixel pulls the pose; gain and heights follow."""
    stride = sums.stride
    w, F = seen.weight[::stride, ::stride].ravel(), align.planes(seen.smooth[::stride, ::stride])
    residual = (F / np.float32(step.gain) - sums.template) * w
    by_gain = np.einsum("cp,cp->p", sums.template, residual)
    of_gain = float(np.sum(sums.template**2 * w, dtype=np.float64))

    def pulled(values: Float32Array) -> FloatArray:
        """(6, P) by which values (C, P) of the features pull the pose, the heights of the ground following."""
        by_north, by_east = (np.einsum("cp,cp->p", a, values) for a in (sums.d_north, sums.d_east))
        pulls = np.asarray(sums.north * by_north + sums.east * by_east, dtype=np.float64)
        if ground is not None and step.by_pose_m is not None:
            pulls += step.by_pose_m[ground.cells[::stride, ::stride].ravel()].T * pulls[align.UP]
        return pulls

    shared = pulled(sums.template * w).sum(1) / max(of_gain, 1e-9)
    return pulled(residual) - np.outer(shared, by_gain)


def _cells(shape: tuple[int, ...]) -> tuple[NDArray[np.intp], int]:
    """Number of the square cell of each pixel, row by row, and how many there are."""
    height, width = shape
    side = math.ceil(max(height, width) / CELLS)
    across = math.ceil(width / side)
    number = (np.arange(height) // side)[:, None] * across + np.arange(width) // side
    return number.ravel(), math.ceil(height / side) * across
