"""The pose that the frame's blocks give: matched once or, where the tilt is not known, again about what they gave before.

A tilt that is still wrong after the alignment shears the blocks and puts those at the border out of reach; matched again at the
pose that the others gave, they come back.

A prior may be far surer of its tilt than it should be (an accelerometer's bias, a camera knocked on its mount). That puts the
camera beside its place by the height times what the tilt is off by, and nothing in the fix would claim it. Over a surface model
blocks tell the tilt to half a degree by themselves; where they contradict the prior it is not believed. Not so over a coarse one:
hills between its samples look like a tilt.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from visloc_companion.localise.blocks import BlockMatches, correspondences, match_blocks, worth
from visloc_companion.localise.candidates.claims import widening
from visloc_companion.localise.candidates.frame_features import FrameFeatures
from visloc_companion.localise.candidates.tilt import WIDEST_RAD
from visloc_companion.localise.candidates.tilt_starts import tilt_is_known
from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.mapped.surface_error import height_covariance, is_coarse
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid
from visloc_companion.localise.pose import PoseEstimate, PriorTerm, freed_of_slope, solve_pose, widened
from visloc_companion.types import FloatArray

CAUCHY = 1.5
"""Blocks are right to a fraction of a pixel or not at all: one that is so many scatters off counts half."""
ROUNDS = 4
"""Of matching blocks anew, where the tilt is not known."""
CONTRADICTED_SIGMAS = 2.5
"""What the blocks show of the tilt is further from an honest prior than that once in 25 times by chance; in fact in one of 109
training cases. Blocks alone err by what they claim, so little is lost where it is chance."""


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
    match = partial(_matched, frame, K, grid, with_surface)
    kept = _rounds(partial(match, widened(prior, sigma_slope_rad), tilt_known), start, 1 if tilt_known else ROUNDS)
    if kept.estimate is None:
        return kept
    told = with_surface and not is_coarse(grid)
    if told and tilt_known and kept.estimate.tilt_sigmas > CONTRADICTED_SIGMAS:
        return _rounds(partial(match, replace(prior, sigma_tilt_rad=WIDEST_RAD), False), start, ROUNDS)
    ground_up_m = float(grid.surface_up_m.mean())
    return replace(kept, estimate=freed_of_slope(kept.estimate, prior, sigma_slope_rad, ground_up_m))


def _rounds(match: Callable[[CameraPose], BlockPose], start: CameraPose, rounds: int) -> BlockPose:
    """Match so many times, each time about the last pose; the round in which most blocks agreed, the first of equals."""
    kept = last = match(start)
    for _ in range(rounds - 1):
        if last.estimate is None:
            break
        last = match(last.estimate.pose)
        if last.estimate is not None and last.blocks.agrees.sum() > kept.blocks.agrees.sum():
            kept = last
    return kept


def _matched(
    frame: FrameFeatures,
    K: FloatArray,
    grid: MapGrid,
    with_surface: bool,
    prior: PriorTerm,
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
