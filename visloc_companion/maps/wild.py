"""Points that lie alone in the air or below the ground: echoes of birds and dust, and errors that no class marks."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from visloc_companion.types import FloatArray

SIDE_M = 5.0
"""Least side of a cube; a sparse cloud gets cubes of SPACINGS times the distance of its points."""
SPACINGS = 4.0
COMPANY = 3
"""A point is wild where its cube and the 26 around it hold fewer points than this, itself included: such a cube about a point of
any surface, at SPACINGS distances a side, holds a hundred."""
MOST_WILD = 0.02
"""Where more than this share lies alone the cloud is that thin, and nothing is left out."""
ROUNDS = 3
"""A point far away blows the box up, and with it the cubes; without it the next round sees more."""


def surface_mask(points_m: FloatArray) -> NDArray[np.bool_]:
    """(N,) which of the points (N, 3), metres, to keep."""
    keep = np.ones(len(points_m), np.bool_)
    for _ in range(ROUNDS):
        alone = _alone(points_m if keep.all() else points_m[keep])
        if not alone.any():
            break
        keep[np.flatnonzero(keep)[alone]] = False
        if np.count_nonzero(~keep) > MOST_WILD * len(keep):
            return np.ones_like(keep)
    return keep


def _alone(points_m: FloatArray) -> NDArray[np.bool_]:
    low = points_m.min(axis=0)
    extent = points_m.max(axis=0) - low
    side = max(SIDE_M, SPACINGS * math.sqrt(float(extent[0] * extent[1]) / len(points_m)))
    while math.prod(sizes := [int(length // side) + 3 for length in extent]) >= 2**62:
        side *= 2
    key = np.zeros(len(points_m), np.int64)
    for axis in range(3):
        key *= sizes[axis]
        key += ((points_m[:, axis] - low[axis]) // side).astype(np.int64) + 1
    cubes, cube_of_point, counts = np.unique(key, return_inverse=True, return_counts=True)
    thin = np.flatnonzero(counts < COMPANY)
    company = np.zeros(len(thin), np.int64)
    steps = (-1, 0, 1)
    for step in ((i * sizes[1] + j) * sizes[2] + k for i in steps for j in steps for k in steps):
        wanted = cubes[thin] + step
        at = np.minimum(np.searchsorted(cubes, wanted), len(cubes) - 1)
        company += np.where(cubes[at] == wanted, counts[at], 0)
    alone = np.zeros(len(cubes), np.bool_)
    alone[thin[company < COMPANY]] = True
    return np.asarray(alone[cube_of_point.reshape(-1)])
