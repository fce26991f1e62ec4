"""How far a place leads any other of the prior's region, by several looks at the ground and by all of them together.

The search compares what stands out at 8 m, as a whole. Two more looks are asked at the heading and scale that it found: the
parts, each on its own, and the parts of what stands out at 2 m. What favours another place by chance in one look seldom does so
in the others: where the looks are added up place by place, a rival has to be good at all of them at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.correlation import NO_SCORE, HeightCorrelator, summits
from visloc_companion.localise.registration.handicap import of_place, of_turn
from visloc_companion.localise.registration.pair import Pair
from visloc_companion.localise.registration.parts import Cells, mean_z, means, z_of
from visloc_companion.localise.registration.search import APART_M, reach_of, region, template
from visloc_companion.localise.registration.similarity import moved, scale_of, yaw_of
from visloc_companion.types import FloatArray

NEAR_CELLS = 2.0
"""The place's own value is the highest so near: it lies between cells."""
OF_SCORES = np.array([0.0, 1.0, 1.0])
"""Which of the looks a handicap is taken from."""
LEAST_APART = 0.5
"""Share of the places searched that have to be others, to tell what is chance."""


@dataclass(frozen=True, slots=True)
class Leads:
    """Fisher's z at a place less the highest of another: `parts` its mean over the parts; `joint` the sum of that, of the mean
    over the parts of the finer relief and of the z of the whole. `rare`: of the parts of both reliefs, each z over what its part
    has by chance (parts.means), added up; 0 where hardly another place is searched. `rival_m`: where (east, north) the
    other place that is best by all takes the source's middle, none where there is none."""

    parts: float
    joint: float
    rare: float = 0.0
    rival_m: tuple[float, float] | None = None


def leads_of(pair: Pair, T: FloatArray, prior: RegistrationPrior, turned: Sequence[FloatArray] = ()) -> Leads:
    """Of the place to which T (4, 4) takes the source, over all others at its heading and scale, and over some that are `turned`
    (4, 4) at its place, each less its handicap. A part sees nothing (z of 0) beyond the reference; 0 where nothing is searched.
    """
    low, high = region(pair, prior)
    if (high < low).any():
        return Leads(0.0, 0.0)
    here = pair.reference.cells_of(moved(T, pair.centre_m)[:2])
    cells = np.hypot(np.arange(low[0], high[0] + 1) - here[0], np.arange(low[1], high[1] + 1)[:, None] - here[1])
    turn = of_turn(yaw_of(T), scale_of(T), prior)
    beside = [_beside(pair, other, prior, (low, high)) + turn * OF_SCORES for other in turned]
    apart = cells >= APART_M / pair.reference.cell_m
    found, rival_m = [], None
    for k, z in enumerate(_looks(pair, T, prior, (low, high))):
        own = float(np.max(z, where=cells <= NEAR_CELLS, initial=NO_SCORE))
        away = np.where(summits(z) & apart, z, np.float32(0))
        row, col = np.unravel_index(int(np.argmax(away)), z.shape)
        found.append(max(own, 0.0) - max([float(away[row, col]), *(float(b[k]) for b in beside)]))
        rival_m = _middle_m(pair, low, int(row), int(col)) if away[row, col] > 0 else None
    return Leads(found[1], found[2], found[0] if apart.mean() >= LEAST_APART else 0.0, rival_m)


def _middle_m(pair: Pair, low: Cells, row: int, col: int) -> tuple[float, float]:
    """East and north of a cell of a box that begins at `low`."""
    east, north = pair.reference.corner_m + pair.reference.cell_m * (low + np.array([col, row]) + 0.5)
    return float(east), float(north)


def parts_z(pair: Pair, T: FloatArray, prior: RegistrationPrior) -> float:
    """Mean z of the parts and that of the parts of the finer relief, added up: the highest so near the place to which T (4, 4)
    takes the source as its own value may lie; 0 beyond the region."""
    low, high = _near(pair, T, region(pair, prior))
    return 0.0 if (high < low).any() else float((mean_z(pair, T, low, high) + mean_z(pair.finer, T, low, high)).max())


def _beside(pair: Pair, T: FloatArray, prior: RegistrationPrior, within: tuple[Cells, Cells]) -> FloatArray:
    """(3,) The highest value of each look about a place, within the region (its first and last cell), less its handicap."""
    low, high = _near(pair, T, within)
    if (high < low).any():
        return np.zeros(3)
    rows, cols = (slice(low[k] - within[0][k], high[k] - within[0][k] + 1) for k in (1, 0))
    looks = _looks(pair, T, prior, within)
    return np.array([float(z[rows, cols].max()) for z in looks]) - of_turn(yaw_of(T), scale_of(T), prior) * OF_SCORES


def _near(pair: Pair, T: FloatArray, within: tuple[Cells, Cells]) -> tuple[Cells, Cells]:
    """First and last cell about the place of T, within the region (its first and last cell); none where one is before the
    other."""
    here = pair.reference.cells_of(moved(T, pair.centre_m)[:2])
    low = np.maximum(np.ceil(here - NEAR_CELLS).astype(int), within[0])
    return low, np.minimum(np.floor(here + NEAR_CELLS).astype(int), within[1])


def _looks(pair: Pair, T: FloatArray, prior: RegistrationPrior, box: tuple[Cells, Cells]) -> list[Float32Array]:
    """(rows, cols) each, over a box of the reference's cells: what is rare of the parts of both reliefs; and less the handicap of
    its place z of the parts, and the sum of it, of that of the finer relief's and of the whole's."""
    low, high = box
    middle, cell = pair.reference.cells_of(pair.centre_m[:2]), pair.reference.cell_m
    u, v = np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1)[:, None]
    handicap = of_place(cell * (u - middle[0]), cell * (v - middle[1]), prior)
    (parts, rare), (finer, finer_rare) = means(pair, T, low, high), means(pair.finer, T, low, high)
    return [rare + finer_rare, parts - handicap, parts + finer + _whole_z(pair, T, low, high) - handicap]


def _whole_z(pair: Pair, T: FloatArray, low: Cells, high: Cells) -> Float32Array:
    """(rows, cols) z of the whole source at the places of a box of the reference's cells."""
    at = (yaw_of(T), scale_of(T))
    reach = reach_of(pair, [at])
    box = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
    whole = template(pair.source_relief, pair.centre_m, *at, pair.reference.cell_m, reach)
    return z_of(HeightCorrelator(pair.reference_relief, box, (-reach, -reach, reach, reach), 1).scores([whole]).score)
