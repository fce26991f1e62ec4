"""The pose that the frame's blocks give: matched once or, where the tilt is not known, again about what they gave before.

A tilt that is still wrong after the alignment shears the blocks and puts those at the border out of reach; matched again at the
pose that the others gave, they come back.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

from visloc_companion.localise.blocks import BlockMatches, correspondences, match_blocks, worth
from visloc_companion.localise.claims import widening
from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.frame_features import FrameFeatures
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid
from visloc_companion.localise.pose import PoseEstimate, PriorTerm, freed_of_slope, solve_pose, widened
from visloc_companion.localise.surface_error import height_covariance
from visloc_companion.localise.tilt_starts import tilt_is_known
from visloc_companion.types import FloatArray

CAUCHY = 1.5
"""Blocks are right to a fraction of a pixel or not at all: one that is so many scatters off counts half."""
ROUNDS = 4
"""Of matching blocks anew, where the tilt is not known."""


@dataclass(frozen=True, slots=True, eq=False)
class BlockPose:
    """Blocks as matched about `pose`, which rectified the frame to features `values` (H, W, C) under `weight` (H, W), and the
    estimate from them (None where they determine none)."""

    pose: CameraPose
    values: Float32Array
    weight: Float32Array
    blocks: BlockMatches
    estimate: PoseEstimate | None


def block_pose(
    frame: FrameFeatures,
    K: FloatArray,
    grid: MapGrid,
    start: CameraPose,
    prior: PriorTerm,
    sigma_slope_rad: float = 0.0,
) -> BlockPose:
    """Match and solve, where the prior does not know the tilt again and again, each time about the last pose; the round in which
    most blocks agreed is kept.

    Where the slope is open there is no surface model, and none that could err.
    """
    with_surface, tilt_known = sigma_slope_rad <= 0, tilt_is_known(prior.sigma_tilt_rad)
    match = partial(_matched, frame, K, grid, widened(prior, sigma_slope_rad), with_surface, tilt_known)
    kept = last = match(start)
    for _ in range(0 if tilt_known else ROUNDS - 1):
        if last.estimate is None:
            break
        last = match(last.estimate.pose)
        if last.estimate is not None and last.blocks.agrees.sum() > kept.blocks.agrees.sum():
            kept = last
    if kept.estimate is None:
        return kept
    ground_up_m = float(grid.surface_up_m.mean())
    return replace(kept, estimate=freed_of_slope(kept.estimate, prior, sigma_slope_rad, ground_up_m))


def _matched(
    frame: FrameFeatures,
    K: FloatArray,
    grid: MapGrid,
    prior: PriorTerm,
    with_surface: bool,
    tilt_known: bool,
    pose: CameraPose,
) -> BlockPose:
    values, mask = frame.on_surface(pose, grid)
    weight = mask * grid.weight
    blocks = match_blocks(grid, values, weight)
    ground, pix, sigma_px = correspondences(blocks, grid, K, pose)
    at_px = blocks.centre_px + blocks.shift_px
    heights_m2 = height_covariance(grid, at_px, blocks.side_px) if with_surface else None
    counts = worth(blocks, tilt_known)
    estimate = solve_pose(
        ground, pix, sigma_px, K, pose, prior, heights_m2=heights_m2, worth=counts, cauchy=CAUCHY, widening=widening
    )
    return BlockPose(pose, values, weight, blocks, estimate)
