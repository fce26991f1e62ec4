"""What is known of a registration once it is found: how well the reliefs agree, what else fits, and what holds it in place."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, fields

import numpy as np

from visloc_companion.localise.registration.pair import Pair
from visloc_companion.localise.registration.refine import Refined, SourceCells, Surface
from visloc_companion.localise.registration.similarity import moved
from visloc_companion.types import FloatArray

BLOCKS = 5
"""Blocks along each side of the source."""
FEWEST_IN_BLOCK = 12
BLOCK_AGREES = 0.3
"""Correlation of a block's relief from which it agrees."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """`correlation` of the reliefs where both are known, `overlap` share of the source that this is; `rival`: the best score
    (correlation times the root of the overlap) at least 6 m away; `blocks`: share of the source's blocks that agree;
    `formal_sigma_m`: worst horizontal sigma of the refinement, `deviation_m` of its height differences, `relief_m` deviation of
    the reference's relief there; `bowl_m` that was taken out; `lift_sigmas` of the height against the prior."""

    correlation: float
    overlap: float
    rival: float
    blocks: float
    formal_sigma_m: float
    deviation_m: float
    relief_m: float
    bowl_m: float
    lift_sigmas: float

    @property
    def score(self) -> float:
        """Comparable with `rival`."""
        return self.correlation * math.sqrt(self.overlap)

    def named(self) -> tuple[tuple[str, float], ...]:
        """As base.Registered carries it."""
        return tuple((f.name, float(v)) for f, v in zip(fields(self), astuple(self), strict=True))


@dataclass(frozen=True, slots=True)
class Agreement:
    """Of the reliefs at a registration: `correlation`, `overlap`, share of `blocks` that agree, deviation of the reference's."""

    correlation: float
    overlap: float
    blocks: float
    relief_m: float

    @property
    def score(self) -> float:
        """Correlation times the root of the overlap."""
        return self.correlation * math.sqrt(self.overlap)


def agreement(pair: Pair, source: SourceCells, relief: Surface, T: FloatArray) -> Agreement:
    """How well the source's relief agrees with the reference's after T."""
    layers = relief.at(moved(T, source.points_m)[:, :2])
    used = relief.holds(layers)
    if used.sum() < FEWEST_IN_BLOCK:
        return Agreement(0.0, 0.0, 0.0, 0.0)
    a, b = source.relief_m[used], layers[used, 0].astype(np.float64)
    off = (source.points_m[used, :2] - pair.centre_m[:2]) / (2 * pair.half_m) + 0.5
    block = np.clip((off * BLOCKS).astype(int), 0, BLOCKS - 1) @ np.array([BLOCKS, 1])
    each = _correlations(a, b, block)
    blocks = float(np.mean(each > BLOCK_AGREES)) if len(each) else 0.0
    whole = _correlations(a, b, np.zeros(len(a), np.int64))[0]
    return Agreement(float(whole), float(used.mean()), blocks, float(b.std()))


def evidence_of(pair: Pair, found: Agreement, refined: Refined, rival: float, sigma_vertical_m: float) -> Evidence:
    """All that is known of one registration."""
    horizontal = np.linalg.eigvalsh(refined.placed[:2, :2])
    lift = moved(refined.T, pair.centre_m)[2] - pair.centre_m[2]
    return Evidence(
        found.correlation,
        found.overlap,
        rival,
        found.blocks,
        math.sqrt(max(0.0, float(horizontal[-1]))),
        refined.height_sigma_m,
        found.relief_m,
        refined.bowl_m,
        float(lift) / sigma_vertical_m,
    )


def _correlations(a: FloatArray, b: FloatArray, group: FloatArray) -> FloatArray:
    """Correlation of a and b in each group of enough values."""
    n = np.bincount(group)
    sums = [np.bincount(group, values) for values in (a, b, a * b, a * a, b * b)]
    enough = n >= FEWEST_IN_BLOCK
    n = n[enough]
    sa, sb, sab, saa, sbb = (s[enough] / n for s in sums)
    spread = np.maximum(saa - sa * sa, 1e-6) * np.maximum(sbb - sb * sb, 1e-6)
    return np.asarray((sab - sa * sb) / np.sqrt(spread), dtype=np.float64)
