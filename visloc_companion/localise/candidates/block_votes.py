"""What the blocks of a frame say of its place, each by itself: a vote that no single structure decides.

The score of a whole frame is a sum over its pixels. One strong line can make most of it: the shore of a lake beside land that
shows little of what the map shows. Where it has moved since the map was made, the frame is placed by it. Here each block votes on
its own, with the posterior over its displacements that a template of its size has (posterior.py: the temperature goes with the
side). A piece of a line votes for all places along it. A block may be wrong altogether, so none can say more against a place than
that it shows something else. And a line is one witness, however long it is: all blocks that it runs through, along one
straight strip of the frame, say no more than one block can.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from visloc_companion.localise.blocks import correlated
from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.ortho_rectify import MapGrid
from visloc_companion.types import FloatArray

BLOCKS_ACROSS, LEAST_SIDE_PX = 6, 8
REACH_PX = 12
"""Other places are looked for so far off on both axes (pixels of the search)."""
NEAR_PX = 3.0
"""What lies as near is the same place."""
MISSED = 0.3
"""Share of the blocks that show nothing of the map where the place is right."""
MOST_NATS = math.log(MISSED + (1 - MISSED) * (2 * REACH_PX + 1) ** 2)
"""That one block can say for a place: it shows that and no other."""
DIRECTIONS, HALF_STRIP = 12, 1.0
"""Of strips that are looked for, and half of their width as a share of a block's side: shores wind."""
ALONG_RAD, CLEAR = math.radians(45.0), 0.15
"""A block counts to a strip where its structure runs within so much of it, and is so far the only one that it has."""


def votes(grid: MapGrid, frame: Float32Array, weight: Float32Array, temperature: float) -> FloatArray:
    """(2 REACH_PX + 1, 2 REACH_PX + 1) log-likelihood (nats) of each displacement, down and to the right, of the frame's features
    (H, W, C) on the map's window, against blocks that all show nothing of it.

    `weight` (H, W) is that of both masks, `temperature` that of the features' posterior times the side of the template.
    """
    size = 2 * REACH_PX + 1
    side = max(LEAST_SIDE_PX, round(math.sqrt(float(weight.sum())) / BLOCKS_ACROSS))
    at, of_blocks = [], []
    for left, top, scores in correlated(grid, frame, weight, side, REACH_PX):
        score = scores.astype(np.float64).ravel()
        likely = np.exp((score - score.max()) * (side / temperature))
        at.append((left, top))
        of_blocks.append(np.log(MISSED + (1 - MISSED) * likely / likely.mean()))
    if not at:
        return np.zeros((size, size))
    nats = np.array(of_blocks)
    along_lines = strips(np.array(at, dtype=np.float64), side, *structure(grid.features, at, side))
    too_much = np.maximum(along_lines @ nats - MOST_NATS, 0.0).max(axis=0)
    return np.asarray((nats.sum(axis=0) - too_much).reshape(size, size), dtype=np.float64)


def share_here(votes_nats: FloatArray) -> float:
    """Probability that the place is the right one, of those within reach and of the blocks showing none of them."""
    v, u = np.indices(votes_nats.shape) - REACH_PX
    near = np.hypot(u, v) <= NEAR_PX
    top = max(0.0, float(votes_nats.max()))
    likely = np.exp(votes_nats - top)
    return float(likely[near].sum() / (likely.sum() + math.exp(-top)))


def strips(at_px: FloatArray, side_px: int, across_rad: FloatArray, clear: FloatArray) -> FloatArray:
    """(K, N) 1 where a block at (N, 2) lies in a straight strip and its own structure runs along it; all strips, half a block
    apart, in all directions.

    `across_rad` (N,): direction across the structure of each block, `clear` (N,): how far it has one, 0 to 1 (`structure`).
    """
    rows = []
    for angle in np.arange(DIRECTIONS) * (math.pi / DIRECTIONS):
        across = at_px @ np.array([math.cos(angle), math.sin(angle)])
        middles = np.arange(across.min(), across.max() + side_px / 2, side_px / 2)
        turned = np.abs((across_rad - angle + math.pi / 2) % math.pi - math.pi / 2)
        runs_along = (turned <= ALONG_RAD) & (clear >= CLEAR)
        rows.append((np.abs(across - middles[:, None]) <= HALF_STRIP * side_px) & runs_along)
    return np.concatenate(rows).astype(np.float64)


def structure(features: Float32Array, at: list[tuple[int, int]], side: int) -> tuple[FloatArray, FloatArray]:
    """Direction (N,) across the strongest structure of blocks at left, top of features (H, W, C), radians from right towards
    down, and how far it is the only one (N,): coherence of the structure tensor (Bigün & Granlund 1987), 0 to 1."""
    du, dv = (cv2.Sobel(features, cv2.CV_32F, *axes, ksize=3) for axes in ((1, 0), (0, 1)))
    products = (np.einsum("hwc,hwc->hw", a, b) for a, b in ((du, du), (du, dv), (dv, dv)))
    uu, uv, vv = (np.array([p[v : v + side, u : u + side].sum(dtype=np.float64) for u, v in at]) for p in products)
    across = 0.5 * np.arctan2(2 * uv, uu - vv)
    return across, np.hypot(uu - vv, 2 * uv) / np.maximum(uu + vv, 1e-12)
