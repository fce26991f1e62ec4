"""Lucas-Kanade from a pose hypothesis: rectify, step, repeat; keeps the best pose that it met."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from visloc_companion.localise import align
from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.frame_features import FrameFeatures
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid
from visloc_companion.localise.pose import PriorTerm
from visloc_companion.types import FloatArray

CORRELATED_PX = 200.0
"""Pixels that share one independent measurement of the gradient features (their noise is as smooth as they are)."""
MIN_PIXELS = 100.0
MAX_STEP_PX = 8.0
CONVERGED_PX = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Rectified:
    """The frame on a map window: features (H, W, C), the same smoothed, and the common weight (H, W)."""

    features: Float32Array
    smooth: Float32Array
    weight: Float32Array


@dataclass(frozen=True, slots=True, eq=False)
class Descended:
    """Where the descent ended: pose, correlation of the features there, information (6, 6) about the pose."""

    pose: CameraPose
    score: float
    information: FloatArray


def rectified(frame: FrameFeatures, pose: CameraPose, grid: MapGrid) -> Rectified:
    """Features of the frame rectified over the map window's surface."""
    values, mask = frame.on_surface(pose, grid)
    return Rectified(values, align.smoothed(values), mask * grid.weight)


def descend(
    frame: FrameFeatures,
    start: CameraPose,
    grid: MapGrid,
    descent: align.Descent,
    prior: PriorTerm,
    steps: int,
) -> Descended:
    """At most `steps` Gauss-Newton steps. Ends early where it has converged, leaps, or gets clearly worse."""
    pose, best = start, Descended(start, -1.0, np.zeros((6, 6)))
    sums = align.block_sums(descent, grid, start)
    for k in range(steps + 1):
        seen = rectified(frame, pose, grid)
        if seen.weight.sum() < MIN_PIXELS:
            break
        information, pull = prior.at(pose)
        step = align.gauss_newton_step(sums, seen.smooth, seen.weight, information, pull, CORRELATED_PX)
        if step.score > best.score:
            best = Descended(pose, step.score, step.information + information)
        moved_px = float(np.abs(step.delta[:3]).max()) / grid.gsd_m
        if k == steps or moved_px > MAX_STEP_PX or step.score < best.score - 0.1:
            break
        pose = align.moved(pose, step.delta)
        if moved_px < CONVERGED_PX:
            break
    return best
