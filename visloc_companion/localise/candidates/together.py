"""The pose from the blocks of two kinds of features, solved together.

Where a map shows little more of what a frame sees than the search looks at, the network's features and gradients see it equally
sharp. Their blocks err by as much, but not all alike: both see the same pixels, and 0.65 of what one kind gets wrong the other
does, too. So both together tell more than one of them, and less than if they were independent.

What a block tells goes with the direction: a block on a road knows where it lies across it and not along it. The correlation
falls off about its peak accordingly.

The verdict is that of the look, as its coefficients were fitted: this makes an accepted answer nearer, and accepts no other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from visloc_companion.geo.raster import apply_affine
from visloc_companion.localise.blocks import (
    REACH_PX,
    BlockMatches,
    block_side_px,
    correlated,
    correspondences,
    curvatures,
    matches_of,
    worth,
)
from visloc_companion.localise.candidates.block_pose import CAUCHY
from visloc_companion.localise.candidates.claims import widening
from visloc_companion.localise.candidates.frame_features import Seen
from visloc_companion.localise.candidates.matching import MARGIN_PX, Match, Task, searched_window
from visloc_companion.localise.candidates.tilt_starts import tilt_is_known
from visloc_companion.localise.features.base import Features
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.mapped.ground import sigma_slope_rad
from visloc_companion.localise.mapped.surface_error import height_covariance
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid, ground_points
from visloc_companion.localise.pose import PoseEstimate, freed_of_slope, solve_pose, widened
from visloc_companion.types import FloatArray

ALIKE = 0.65
"""Correlation of both kinds' errors: two that are as good, and so much alike, tell 2 / (1 + ALIKE) times what one does. Of poses
0.65 at a footprint of 64 px and 0.59 at 96 px, of blocks 0.64 and 0.38 (NAIP rows < 400, procedural worlds 72 to 83)."""
CURVED_POWER = 0.5
"""Of the curvature, that a block's information goes with: a curvature of few pixels is a guess itself. On the same data."""
LEAST_CURVATURE = 1e-4
LEAST_OF_SEARCHED = 0.9
"""Of a pixel of the search, that one of the refinement has: where it is finer, gradients are sharper by that."""
LEAST_BLOCKS = 3
"""Of each kind, to have a scatter."""


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Blocks matched on a window of the map, and the curvature (N, 2, 2) of each one's correlation."""

    grid: MapGrid
    matches: BlockMatches
    curvature: FloatArray


def solved_together(task: Task, match: Match, searched: MapGrid) -> PoseEstimate | None:
    """The pose by gradients and by the features that were searched with, on the window that was `searched`; None where that is
    much coarser than what the match was refined on, where a second look did without gradients, where the tilt was not known or
    not believed, or where there are too few blocks of either kind. Raises OutsideMap."""
    estimate, prior, pose = match.estimate, task.whole_prior(), match.descended.pose
    if task.features is GRADIENT or task.fine_features is not GRADIENT or estimate is None:
        return None
    if match.gsd_m < LEAST_OF_SEARCHED * searched.gsd_m:
        return None
    if not tilt_is_known(prior.sigma_tilt_rad) or estimate.sigma_tilt_rad != prior.sigma_tilt_rad:
        return None
    by_gradients = task.refinement(match.gsd_m) is GRADIENT
    other = _by_searched(task, pose, searched) if by_gradients else _by_gradients(task, pose, match.gsd_m)
    kinds = _blocks(match.grid, match.seen), other
    if min(len(kind.matches.peak) for kind in kinds) < LEAST_BLOCKS:
        return None
    slope_rad = sigma_slope_rad(match.grid.surface_up_m, math.sqrt(task.plan.area_m2))
    K = task.level(match.gsd_m).K
    found = [correspondences(kind.matches, kind.grid, K, pose) for kind in kinds]
    ground, pix, sigma_px = (np.concatenate(parts) for parts in zip(*found, strict=True))
    together = solve_pose(
        ground,
        pix,
        sigma_px,
        K,
        pose,
        widened(prior, slope_rad),
        heights_m2=None if slope_rad > 0 else _heights(match.grid, kinds),
        worth=np.concatenate([worth(kind.matches) for kind in kinds]) / (1 + ALIKE),
        cauchy=CAUCHY,
        widening=widening,
        whitening=np.concatenate([_whitening(kind, K, pose) for kind in kinds]) * sigma_px[:, None, None],
        channel=np.repeat(np.arange(len(kinds)), [len(kind.matches.peak) for kind in kinds]),
    )
    if together is None:
        return None
    return freed_of_slope(together, prior, slope_rad, float(match.grid.surface_up_m.mean()))


def _by_gradients(task: Task, pose: CameraPose, gsd_m: float) -> Blocks:
    with task.map_side:
        grid = task.window(pose, gsd_m, GRADIENT, MARGIN_PX)
    return _matched(task, pose, grid, GRADIENT)


def _by_searched(task: Task, pose: CameraPose, searched: MapGrid) -> Blocks:
    return _matched(task, pose, searched_window(task, searched, pose, MARGIN_PX), task.features)


def _matched(task: Task, pose: CameraPose, grid: MapGrid, features: Features) -> Blocks:
    values, mask = task.frame(grid, features).on_surface(pose, grid)
    return _blocks(grid, (values, mask * grid.weight))


def _blocks(grid: MapGrid, seen: Seen) -> Blocks:
    side_px = block_side_px(seen[1])
    matched = list(correlated(grid, *seen, side_px, REACH_PX))
    return Blocks(grid, matches_of(matched, side_px), curvatures([score for _, _, score in matched]))


def _heights(grid: MapGrid, kinds: Sequence[Blocks]) -> FloatArray:
    """Covariance (N, N) of what the surface model is off by below the blocks of all kinds, which share it."""
    at_ne_m = np.concatenate([apply_affine(k.grid.A_ne_pix, k.matches.centre_px + k.matches.shift_px) for k in kinds])
    at_px = (at_ne_m - grid.A_ne_pix[:, 2]) @ np.linalg.inv(grid.A_ne_pix[:, :2]).T
    return height_covariance(grid, at_px, kinds[0].matches.side_px)


def _whitening(kind: Blocks, K: FloatArray, pose: CameraPose) -> FloatArray:
    """(N, 2, 2) what turns frame pixels into a vector of so many pixels of the map in each direction as its block can tell there,
    in the median of all 1: the root of its curvature's power times the inverse of what a step on the map is in the frame."""
    values, axes = np.linalg.eigh(kind.curvature)
    tells = np.maximum(values, LEAST_CURVATURE) ** CURVED_POWER
    tells /= np.median(tells.mean(axis=1))
    root = np.einsum("nij,nj,nkj->nik", axes, np.sqrt(tells), axes)
    return np.asarray(root @ np.linalg.inv(_steps(kind, K, pose)), dtype=np.float64)


def _steps(kind: Blocks, K: FloatArray, pose: CameraPose) -> FloatArray:
    """(N, 2, 2) frame pixels of a step of one pixel right and down on the map's window where each block was matched."""
    at = ground_points(kind.grid, kind.matches.centre_px + kind.matches.shift_px)
    q = (at - pose.p_ned_m) @ pose.R_ned_cam
    d_q = pose.R_ned_cam[:2].T @ kind.grid.A_ne_pix[:, :2]
    ahead = np.maximum(q[:, 2], 1.0)
    d_uv = (d_q[None, :2] - (q[:, :2] / ahead[:, None])[:, :, None] * d_q[None, 2:]) / ahead[:, None, None]
    return np.asarray(d_uv * np.array([K[0, 0], K[1, 1]])[:, None], dtype=np.float64)
