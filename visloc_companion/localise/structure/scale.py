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


@dataclass(frozen=True, slots=True)
class Scale:
    """Factor on the distances from the cameras' middle, its relative 1-sigma, and by how many sigmas the heights differ from the
    baselines (median over the frames)."""

    factor: float
    sigma: float
    apart_sigmas: float


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

    A beam among crowns meets anything between the lowest and the highest of what is below.
    """
    information, pull = 1 / sigma**2, 0.0
    measured: list[tuple[float, float]] = []
    for frame, T in zip(frames, T_local_cam, strict=True):
        near = np.hypot(*(points_m[:, :2] - T[:2, 3]).T) < max(LEAST_BEAM_M, BEAM_SHARE * frame.height_m)
        if not math.isfinite(frame.sigma_height_m) or int(near.sum()) < LEAST_BELOW:
            continue
        below = points_m[near, 2]
        height = float(T[2, 3] - np.median(below))
        low, high = np.percentile(below, (2, 98))
        variance = (frame.sigma_height_m**2 + float(high - low) ** 2 / UNIFORM**2) / height**2
        measured.append((frame.height_m / height - 1, variance))
        information += 1 / variance
        pull += (frame.height_m / height - 1) / variance
    change = pull / information
    apart = float(np.median([abs(r) / math.sqrt(v + sigma**2) for r, v in measured])) if measured else 0.0
    return Scale(1 + change, math.sqrt(1 / information), apart)
