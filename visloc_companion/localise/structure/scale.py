"""The cloud's scale: baselines give one, heights above the surface another; both have a sigma and are weighed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from visloc_companion.localise.structure.base import PosedFrame
from visloc_companion.localise.structure.bundle import Bundle
from visloc_companion.types import FloatArray

BEAM_SHARE, LEAST_BEAM_M = 0.03, 1.5
"""The surface straight below is that within this share of the height (and at least so far) of the camera's nadir."""
UNIFORM = 12**0.5
LEAST_BELOW = 5
TINY = 1e-8


@dataclass(frozen=True, slots=True)
class Scale:
    """Factor on the distances from the cameras' middle, its relative 1-sigma, by how many sigmas the heights differ from the
    baselines, and by how much the factor is greater for each metre that all heights are too great by."""

    factor: float
    sigma: float
    apart_sigmas: float
    per_height: float = 0.0


def baseline_sigma(bundle: Bundle) -> float:
    """Relative 1-sigma of the length of the baselines (frame 0 to each other one, which the tracks tie together)."""
    f = len(bundle.T_local_cam)
    C = bundle.T_local_cam[:, :3, 3]
    row = np.zeros((f, 6))
    for k in range(1, f):
        b = C[k] - C[0]
        along = b / float(b @ b) / (f - 1)
        row[k, :3] += along
        row[0, :3] -= along
    return math.sqrt(float(row.ravel() @ bundle.covariance @ row.ravel()))


def from_heights(frames: Sequence[PosedFrame], T_local_cam: FloatArray, points_m: FloatArray, sigma: float) -> Scale:
    """Weigh the baselines' scale (1, `sigma`) with the heights that frames claim above the points below them.

    A beam among crowns meets anything between the lowest and the highest of what is below. What a frame claims to be wrong by,
    all of them are: one barometer and one map gave all the heights.
    """
    ratios, scatter, heights, shared = [], [], [], []
    for frame, T in zip(frames, T_local_cam, strict=True):
        near = np.hypot(*(points_m[:, :2] - T[:2, 3]).T) < max(LEAST_BEAM_M, BEAM_SHARE * frame.height_m)
        if not math.isfinite(frame.sigma_height_m) or int(near.sum()) < LEAST_BELOW:
            continue
        below = points_m[near, 2]
        height = float(T[2, 3] - np.median(below))
        low, high = np.percentile(below, (2, 98))
        heights.append(height)
        ratios.append(frame.height_m / height - 1)
        scatter.append((float(high - low) / UNIFORM / height) ** 2)
        shared.append((frame.sigma_height_m / height) ** 2)
    if not ratios:
        return Scale(1.0, sigma, 0.0)
    weight = 1 / (np.array(scatter) + TINY)
    ratio, variance = float(np.average(ratios, weights=weight)), float(1 / weight.sum() + np.mean(shared))
    information = 1 / sigma**2 + 1 / variance
    apart = abs(ratio) / math.sqrt(variance + sigma**2)
    share = 1 / variance / information
    per_height = share * float(np.average(1 / np.array(heights), weights=weight))
    return Scale(1 + share * ratio, math.sqrt(1 / information), apart, per_height)
