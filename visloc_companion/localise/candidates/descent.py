"""Lucas-Kanade from a pose hypothesis: rectify, step, repeat; keeps the best pose that it met."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from visloc_companion.localise import align
from visloc_companion.localise.candidates.frame_features import FrameFeatures, FramePass, Seen, shown
from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.mapped.open_ground import OpenGround
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid, hidden
from visloc_companion.localise.pose import PriorTerm
from visloc_companion.types import FloatArray

CORRELATED_PX = 200.0
"""Pixels that share one independent measurement of the gradient features (their noise is as smooth as they are)."""
MIN_PIXELS = 100.0
MAX_STEP_PX = 8.0
CONVERGED_PX = 0.02
HOPELESS = (0.5, 0.65, 0.72)
"""A descent ends where it scores less than this share of the best one's score, at its start and after one and more steps."""


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


@dataclass(frozen=True, slots=True, eq=False)
class Rivals:
    """Where other descents of the same search ended: one that comes within `radius_m` of them, or is hopeless, ends there."""

    found: Sequence[Descended]
    radius_m: float

    def reached(self, pose: CameraPose) -> bool:
        """Whether a pose is where another ended."""
        p = pose.p_ned_m
        return any(math.hypot(p[0] - c.pose.p_ned_m[0], p[1] - c.pose.p_ned_m[1]) < self.radius_m for c in self.found)

    def hopeless(self, score: float, step: int) -> bool:
        """Whether a score after so many steps is too far behind the best."""
        best = max((c.score for c in self.found), default=0.0)
        return score < HOPELESS[min(step, len(HOPELESS) - 1)] * best


NO_RIVALS = Rivals((), 0.0)


def rectified(frame: FrameFeatures, pose: CameraPose, grid: MapGrid) -> Rectified:
    """Features of the frame rectified over the map window's surface."""
    values, mask = frame.on_surface(pose, grid)
    values = shown(values, mask)
    return Rectified(values, align.smoothed(values), mask * grid.weight)


def descend(
    frame: FrameFeatures,
    start: CameraPose,
    grid: MapGrid,
    descent: align.Descent,
    prior: PriorTerm,
    steps: int,
) -> Descended:
    """At most `steps` Gauss-Newton steps, the frame's features made anew for each."""

    def look(pose: CameraPose) -> Seen:
        seen = rectified(frame, pose, grid)
        return seen.smooth, seen.weight

    return _descended(look, start, grid, descent, prior, steps, NO_RIVALS)[0]


def descend_open(
    frame: FrameFeatures,
    start: CameraPose,
    grid: MapGrid,
    descent: align.Descent,
    prior: PriorTerm,
    steps: int,
    ground: OpenGround,
) -> tuple[Descended, OpenGround]:
    """The same with the ground's heights solved for as well, beginning with those of `ground`; and those where it ended."""
    pose, best, there = start, Descended(start, -1.0, np.zeros((6, 6))), ground
    for k in range(steps + 1):
        raised = ground.on(grid)
        seen = rectified(frame, pose, raised)
        if _shows_too_little(seen.weight, descent):
            break
        step, here = _stepped(align.map_sums(descent, raised, pose), (seen.smooth, seen.weight), pose, prior, ground)
        if step.score > best.score:
            best, there = here, ground
        moved_px = float(np.abs(step.delta[:3]).max()) / grid.gsd_m
        if k == steps or step.ground is None or not _goes_on(step, best, moved_px):
            break
        pose, ground = align.moved(pose, step.delta), step.ground
    return best, there


def descend_resampled(
    smooth: FramePass,
    start: CameraPose,
    grid: MapGrid,
    descent: align.Descent,
    prior: PriorTerm,
    steps: int,
    rivals: Rivals = NO_RIVALS,
) -> tuple[Descended, bool]:
    """The same on low-passed features that are resampled for each step; and whether it came to where a rival had ended."""
    behind = hidden(start, grid)

    def look(pose: CameraPose) -> Seen:
        values, mask = smooth.on_surface(pose, grid, behind)
        return values, mask * grid.weight

    return _descended(look, start, grid, descent, prior, steps, rivals)


def _descended(
    look: Callable[[CameraPose], Seen],
    start: CameraPose,
    grid: MapGrid,
    descent: align.Descent,
    prior: PriorTerm,
    steps: int,
    rivals: Rivals,
) -> tuple[Descended, bool]:
    """Ends early where it has converged, leaps, gets clearly worse, or because of its rivals."""
    pose, best = start, Descended(start, -1.0, np.zeros((6, 6)))
    sums = align.map_sums(descent, grid, start)
    for k in range(steps + 1):
        seen = look(pose)
        if _shows_too_little(seen[1], descent):
            break
        step, here = _stepped(sums, seen, pose, prior)
        if step.score > best.score:
            best = here
        moved_px = float(np.abs(step.delta[:3]).max()) / grid.gsd_m
        if k == steps or not _goes_on(step, best, moved_px) or rivals.hopeless(best.score, k):
            break
        pose = align.moved(pose, step.delta)
        if rivals.reached(pose):
            return best, True
        if moved_px < CONVERGED_PX:
            break
    return best, False


def _shows_too_little(weight: Float32Array, descent: align.Descent) -> bool:
    """Whether a rectified frame of such a weight (H, W) shows too little of the map to be aligned."""
    return bool(weight.sum() * descent.stride**2 < MIN_PIXELS)


def _stepped(
    sums: align.MapSums, seen: Seen, pose: CameraPose, prior: PriorTerm, ground: OpenGround | None = None
) -> tuple[align.Step, Descended]:
    """The Gauss-Newton step from a pose, and what is known of that pose."""
    information, pull = prior.at(pose)
    step = align.gauss_newton_step(sums, *seen, information, pull, CORRELATED_PX, ground)
    return step, Descended(pose, step.score, step.information + information)


def _goes_on(step: align.Step, best: Descended, moved_px: float) -> bool:
    """Whether a step is no leap, and its start not clearly worse than the best pose."""
    return moved_px <= MAX_STEP_PX and step.score >= best.score - 0.1
