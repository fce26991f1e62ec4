"""Whether the quarters of a frame, each by itself, show one place of all that were searched.

The score of a whole frame is one number for each place, and what lifts it may be a single field's border. Four quarters that err
do so at places of their own; where all four are alike to one place and to no other, it is that. Each is correlated with the whole
search's map under the heading and scale of a match, and votes with the posterior that a template of its size has, as a block does
for the places close by (block_votes.py): none can say more against a place than that it shows something else.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.candidates.block_votes import MISSED, NEAR_PX
from visloc_companion.localise.candidates.frame_features import Seen
from visloc_companion.localise.candidates.hypotheses import region
from visloc_companion.localise.candidates.posterior import log_sum
from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid
from visloc_companion.localise.plan import SearchPlan
from visloc_companion.localise.search import NO_SCORE, ScoreVolume, Template, search
from visloc_companion.localise.spectra import Box
from visloc_companion.types import FloatArray

LEAST_SHARE = 0.08
"""Of what is seen of the frame: a quarter that holds less, because the frame lies askew, is left out."""
APART = 0.06
"""Other places are as far off as this share of the footprint's side, and more than NEAR_PX."""


def quarters_log_odds(
    grid: MapGrid, window: MapGrid, seen: Seen, pose: CameraPose, plan: SearchPlan, temperature: float
) -> float | None:
    """Nats by which the quarters of a frame speak for the place of a pose against all others within the prior's 3 sigmas and
    against showing none of them; None where there are no others, or nothing is seen.

    `grid` is the map that was searched, `window` the part of it that the pose sees, on which the frame is `seen`; `temperature`
    that of the posterior times the side of the template.
    """
    weight = seen[1]
    nadir_px = np.linalg.solve(grid.A_ne_pix[:, :2], pose.p_ned_m[:2] - grid.A_ne_pix[:, 2])
    first_px = np.linalg.solve(grid.A_ne_pix[:, :2], window.A_ne_pix[:, 2] - grid.A_ne_pix[:, 2])
    at, offset = np.rint(nadir_px).astype(int), np.rint(first_px - nadir_px).astype(int)
    box = _places(grid, plan, offset, weight.shape, at)
    u, v = np.arange(box[0], box[2] + 1) - at[0], (np.arange(box[1], box[3] + 1) - at[1])[:, None]
    off_px = np.hypot(u, v)
    shape = off_px.shape
    allowed = region(ScoreVolume(np.zeros(shape, np.float32), np.zeros(shape, np.int32), (box[0], box[1])), grid, plan)
    near, away = off_px <= NEAR_PX, allowed & (off_px > max(NEAR_PX, APART * math.sqrt(float(weight.sum()))))
    if not (away.any() and weight.any()):
        return None
    nats = [
        _votes(_scores(grid, part, offset, box), near | away, temperature / math.sqrt(float(part.mask.sum())))
        for part in _quarters(*seen)
    ]
    together = np.sum(nats, axis=0)
    others = np.logaddexp(log_sum(together[away]), math.log(np.count_nonzero(near)))
    return log_sum(together[near]) - float(others)


def _places(grid: MapGrid, plan: SearchPlan, offset: NDArray[np.intp], shape: tuple[int, ...], at: NDArray[np.intp]) -> Box:
    """Pixels of the nadir under which half of the template lies on the map, within the prior's reach; a pose's own among them."""
    inverse = np.linalg.inv(grid.A_ne_pix[:, :2])
    centre, reach = inverse @ (plan.pose.p_ned_m[:2] - grid.A_ne_pix[:, 2]), np.abs(inverse) @ plan.region_half_m
    middle = offset + np.array(shape[::-1]) // 2
    own = math.ceil(NEAR_PX)
    low = np.minimum(np.maximum(np.floor(centre - reach), -middle), at - own).astype(int)
    high = np.maximum(np.minimum(np.ceil(centre + reach), np.array(grid.weight.shape[::-1]) - middle), at + own).astype(int)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _quarters(values: Float32Array, weight: Float32Array) -> Iterator[Template]:
    """The quarters of what is seen of a frame, each with its place in the frame's window."""
    rows, cols = (np.flatnonzero(weight.any(axis)) for axis in (1, 0))
    across, down = (np.linspace(seen[0], seen[-1] + 1, 3).round().astype(int).tolist() for seen in (cols, rows))
    for v0, v1 in pairwise(down):
        for u0, u1 in pairwise(across):
            part = np.ascontiguousarray(weight[v0:v1, u0:u1])
            if part.sum() > LEAST_SHARE * weight.sum():
                yield Template(np.ascontiguousarray(values[v0:v1, u0:u1]), part, (u0, v0))


def _scores(grid: MapGrid, part: Template, offset: NDArray[np.intp], box: Box) -> Float32Array:
    """Normalised correlation of a quarter at each place of the nadir in a box."""
    u, v = int(offset[0]) + part.offset_px[0], int(offset[1]) + part.offset_px[1]
    height, width = part.mask.shape
    template = Template(part.features, part.mask, (u, v))
    return search(grid.features, grid.weight, lambda _: template, 1, box, (u, v, u + width - 1, v + height - 1)).score


def _votes(score: Float32Array, counted: NDArray[np.bool_], temperature: float) -> FloatArray:
    """Log-likelihood (nats) of each place by one quarter, against showing nothing of the map; of those that count."""
    known = counted & (score > NO_SCORE)
    if not known.any():
        return np.zeros(score.shape)
    likely = np.where(known, np.exp((score.astype(np.float64) - float(score[known].max())) / temperature), 0.0)
    return np.asarray(np.log(MISSED + (1 - MISSED) * likely / likely[known].mean()), dtype=np.float64)
