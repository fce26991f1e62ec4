"""References that reach farther than the clouds do: a case's own reference amid mirrored ones of other cases.

Mirrored ground is like the case's own and never the place that is sought. All tiles are thinned to one density, as one survey
would have it, and lie at one median height, as the shared tool leaves them.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.cloud_sets.cloud_cases import CloudCase

Array = NDArray[np.float64]
MOST_PER_M2 = 2.0


def mosaic(case: CloudCase, others: list[CloudCase], middle_m: Array, half_m: float, rng: np.random.Generator) -> CloudCase:
    """The case with a reference of tiles as wide as its own that fill a square about a place (2,) of its reference's frame."""
    own = case.reference_m
    low, high = own[:, :2].min(0), own[:, :2].max(0)
    centre, side = (low + high) / 2, float((high - low).min())
    density = min(MOST_PER_M2, len(own) / float(np.prod(high - low)))
    first, last = (np.floor((middle_m + out - centre) / side + 0.5).astype(int) for out in (-half_m, half_m))
    tiles = []
    for at in itertools.product(*(range(a, b + 1) for a, b in zip(first, last, strict=True))):
        tile = own - [*centre, 0] if at == (0, 0) else _mirrored(others[rng.integers(len(others))].reference_m, rng)
        tile = tile[(np.abs(tile[:, :2]) <= side / 2).all(1)]
        keep = rng.permutation(len(tile))[: round(density * side**2)]
        tiles.append(tile[keep] + [*(centre + side * np.array(at)), 0])
    return replace(case, reference_m=np.concatenate(tiles))


def displaced(case: CloudCase, error_m: Array, sigma_m: float) -> CloudCase:
    """The case with a prior whose place is off by an error (2,), of a 1-sigma of each axis."""
    assert case.T_true is not None
    middle = case.source_m.mean(0)
    shift = np.append((case.T_true[:3] @ [*middle, 1] - middle)[:2] - error_m, 0.0)
    back = np.eye(4)
    back[:3, 3] = -shift
    prior = replace(case.prior, sigma_horizontal_m=sigma_m)
    return replace(case, source_m=case.source_m + shift, T_true=case.T_true @ back, prior=prior)


def _mirrored(points_m: Array, rng: np.random.Generator) -> Array:
    """About the middle of its box, turned by a multiple of 90 degrees."""
    middle = (points_m[:, :2].min(0) + points_m[:, :2].max(0)) / 2
    x, y = ((points_m[:, :2] - middle) * [-1, 1]).T
    turned = ((x, y), (-y, x), (-x, -y), (y, -x))[int(rng.integers(4))]
    return np.column_stack([*turned, points_m[:, 2]])
