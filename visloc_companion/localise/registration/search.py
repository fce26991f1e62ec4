"""Where the source may lie in the reference: the best places of an exhaustive search of height maps over the prior's region."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.base import Mask
from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.correlation import (
    MIN_OVERLAP,
    NO_SCORE,
    HeightCorrelator,
    Scores,
    Template,
    peaks,
    summits,
)
from visloc_companion.localise.registration.handicap import LEAST_SIGMA, of_place, of_turn
from visloc_companion.localise.registration.height_map import HeightMap
from visloc_companion.localise.registration.pair import SIGMAS, Pair
from visloc_companion.localise.registration.similarity import about
from visloc_companion.types import FloatArray

EDGE_STEP_CELLS = 1.5
"""Headings and scales are so close that the source's edge moves by this many cells between them."""
MOST_LOG_SCALE = 5.0
"""A source of a size that is not known to a factor of 150 is not searched for: the ladder of scales would fill the memory."""
UNIFORM_SIGMAS = math.sqrt(3)
"""A uniform distribution reaches so many of its sigmas."""
APART_M = 6.0
"""Two places are two where they are this far from each other."""


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A candidate: `T` (4, 4) start of a refinement, and its correlation."""

    T: FloatArray
    score: float


def hypotheses(half_m: float, cell_m: float, prior: RegistrationPrior) -> list[tuple[float, float]]:
    """(heading, scale) that cover three sigma, of headings at most the circle."""
    headings, scales = _ladders(half_m, cell_m, prior)
    return [(yaw, math.exp(log_scale)) for log_scale, yaw in itertools.product(scales, headings)]


def find_places(pair: Pair, prior: RegistrationPrior, most: int) -> tuple[list[Place], Scores]:
    """The best places, best first, and the scores at the reference's cells. None where the two nowhere overlap enough."""
    pairs = hypotheses(pair.half_m, pair.reference.cell_m, prior)
    scores = search(pair, pairs, prior)
    found = []
    for u, v, k, score in peaks(scores, APART_M / pair.reference.cell_m, most):
        to = pair.reference.corner_m + pair.reference.cell_m * (np.array([u, v]) + 0.5)
        shift = np.array([*(to - pair.centre_m[:2]), 0.0])
        found.append(Place(about(pair.centre_m, *pairs[k], shift), score))
    return found, scores


def work(pair: Pair, prior: RegistrationPrior) -> float:
    """What a search costs: hypotheses times the cells that they are correlated over. Time goes with it, memory with the cells."""
    if SIGMAS * prior.sigma_scale > MOST_LOG_SCALE:
        return math.inf
    headings, scales = _ladders(pair.half_m, pair.reference.cell_m, prior)
    low, high = region(pair, prior)
    wide = np.maximum(high - low + 1, 0) + 2 * reach_of(pair, [(0.0, math.exp(scales[-1]))])
    return float(len(headings) * len(scales) * int(wide[0]) * int(wide[1]))


def search(pair: Pair, pairs: list[tuple[float, float]], prior: RegistrationPrior) -> Scores:
    """Scores of the source's relief, turned and scaled by (heading, scale), over the prior's region of the reference."""
    cell, reach = pair.reference.cell_m, reach_of(pair, pairs)
    middle, (low, high) = pair.reference.cells_of(pair.centre_m[:2]), region(pair, prior)
    if (high < low).any():
        return Scores(np.zeros((0, 0), np.float32), np.zeros((0, 0), np.int32), (0, 0), 1.0)
    box = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
    correlator = HeightCorrelator(pair.reference_relief, box, (-reach, -reach, reach, reach), len(pairs))
    templates = (template(pair.source_relief, pair.centre_m, *p, cell, reach) for p in pairs)
    scores = correlator.scores(replace(t, handicap=of_turn(*p, prior)) for t, p in zip(templates, pairs, strict=True))
    off = [cell * (np.arange(low[k], high[k] + 1) - middle[k]) for k in range(2)]
    unseen = _unseen(scores.score > NO_SCORE, off, cell, prior)
    return replace(scores, score=scores.score - of_place(off[0], off[1][:, None], prior), unseen=unseen)


def runner_up(pair: Pair, scores: Scores, at_m: FloatArray) -> float:
    """The highest peak at least APART_M from places (..., 2), 0 where there is none. The sides of a place's own are no peaks."""
    u, v = (pair.reference.cells_of(np.reshape(at_m, (-1, 2))) - scores.origin).T[:, :, None]
    rows, cols = np.nonzero(summits(scores.score))
    away = ((rows - v) ** 2 + (cols - u) ** 2 >= (APART_M / pair.reference.cell_m) ** 2).all(0)
    return max(0.0, float(np.max(scores.score[rows, cols], where=away, initial=0.0)))


def template(source: HeightMap, centre_m: FloatArray, yaw: float, scale: float, cell_m: float, reach: int) -> Template:
    """The source turned and scaled about its centre, on the reference's cells."""
    c, s = math.cos(yaw), math.sin(yaw)
    to_source = np.array([[c, s], [-s, c]]) * (cell_m / (scale * source.cell_m))
    middle = source.cells_of(centre_m[:2])
    matrix = np.column_stack([to_source, middle - to_source @ np.array([reach, reach])])
    size = (2 * reach + 1, 2 * reach + 1)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    weight = cv2.warpAffine(source.known.astype(np.float32), matrix, size, flags=flags)
    height = cv2.warpAffine(source.height_m, matrix, size, flags=flags) / np.maximum(weight, 1e-6)
    known = weight > 0.5
    return Template(np.where(known, height * np.float32(scale), 0).astype(np.float32), known, (-reach, -reach))


def reach_of(pair: Pair, pairs: list[tuple[float, float]]) -> int:
    """How many cells the turned and scaled source reaches from its centre."""
    return math.ceil(pair.half_m * math.sqrt(2) * max(s for _, s in pairs) / pair.reference.cell_m) + 1


def region(pair: Pair, prior: RegistrationPrior) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """First and last cell (2,) of the reference's raster that the source's centre may lie on; none where one is before the other.

    Beyond the reference's edge it may lie as far as enough of the source still lies within.
    """
    middle, far = pair.reference.cells_of(pair.centre_m[:2]), SIGMAS * prior.sigma_horizontal_m / pair.reference.cell_m
    rows, cols = pair.reference.known.shape
    beyond = math.ceil((1 - 2 * MIN_OVERLAP) * pair.half_m / pair.reference.cell_m)
    low = np.maximum(np.floor(middle - far), -beyond).astype(int)
    return low, np.minimum(np.ceil(middle + far), [cols - 1 + beyond, rows - 1 + beyond]).astype(int)


def _unseen(seen: Mask, off_m: list[FloatArray], cell_m: float, prior: RegistrationPrior) -> float:
    """Probability, by the prior alone, of the places that are not `seen` (rows, cols); its columns and rows lie `off_m` from the
    prior's place. Of a Gaussian prior within 3 sigma, else of the uniform one of this sigma."""
    if not math.isfinite(prior.sigma_horizontal_m):
        return 0.0
    u, v = (_shares(along, cell_m, prior) for along in off_m)
    return min(1.0, max(0.0, 1 - float(v @ seen @ u)))


def _shares(off_m: FloatArray, cell_m: float, prior: RegistrationPrior) -> FloatArray:
    """(N,) of the prior's probability on one axis, what cells that lie so far from its place hold."""
    reach = SIGMAS if prior.gaussian else UNIFORM_SIGMAS
    edges = np.append(off_m - cell_m / 2, off_m[-1] + cell_m / 2) / max(prior.sigma_horizontal_m, LEAST_SIGMA)
    within = np.clip(edges / reach, -1, 1)
    if prior.gaussian:
        within = np.array([math.erf(reach * e / math.sqrt(2)) for e in within]) / math.erf(reach / math.sqrt(2))
    return np.diff(within) / 2


def _ladders(half_m: float, cell_m: float, prior: RegistrationPrior) -> tuple[list[float], list[float]]:
    """Headings (radians) and logarithms of scales, ascending."""
    step = EDGE_STEP_CELLS * cell_m / half_m
    return _ladder(min(SIGMAS * prior.sigma_yaw_rad, math.pi), step), _ladder(SIGMAS * prior.sigma_scale, step)


def _ladder(far: float, step: float) -> list[float]:
    """Steps no longer than `step` that cover ±far: an odd number, so that zero is one; half a step is left at the ends."""
    n = max(0, math.ceil(far / step - 0.5))
    return [far * k / (n + 0.5) for k in range(-n, n + 1)] if n else [0.0]
