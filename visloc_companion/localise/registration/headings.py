"""Other headings at a place that was found: ground that is alike about its middle (a roundabout, a stadium, a square of houses)
fits there turned as well, and no other place tells of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from visloc_companion.localise.features.base import Mask
from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.correlation import NO_SCORE, HeightCorrelator
from visloc_companion.localise.registration.handicap import of_place, of_turn
from visloc_companion.localise.registration.pair import Pair
from visloc_companion.localise.registration.search import APART_M, hypotheses, reach_of, region, template
from visloc_companion.localise.registration.similarity import about, moved, scale_of, yaw_of
from visloc_companion.types import FloatArray

MOST_APART_RAD = math.pi / 4
"""Two headings are two from here on, however small the source is; and the parts of a source may be asked for them (leads.py):
less moves those about the middle hardly, and they agree either way."""


@dataclass(frozen=True, slots=True, eq=False)
class Headings:
    """At one place and scale: (K,) headings in radians, ascending, and the best score about the place at each, as a search has
    it; (K, 2) where that is, east and north of the reference. `around`: the last is beside the first."""

    yaw_rad: FloatArray
    score: FloatArray
    at_m: FloatArray
    around: bool

    def away_from(self, yaws_rad: Sequence[float], apart_rad: float) -> Mask:
        """(K,) which are peaks at least so far from some headings. The sides of a heading's own are no peaks."""
        before, after = np.roll(self.score, 1), np.roll(self.score, -1)
        if not self.around:
            before[:1] = after[-1:] = NO_SCORE
        peak = (self.score >= before) & (self.score >= after) & (self.score > NO_SCORE)
        for yaw in yaws_rad:
            peak &= np.abs(wrapped(self.yaw_rad - yaw)) >= apart_rad
        return np.asarray(peak)

    def rival(self, yaws_rad: Sequence[float], apart_rad: float) -> float:
        """The highest peak away from some headings, 0 where there is none."""
        return float(np.max(self.score, where=self.away_from(yaws_rad, apart_rad), initial=0.0))


def headings_at(pair: Pair, T: FloatArray, prior: RegistrationPrior) -> Headings:
    """The prior's headings about the place and at the scale that T (4, 4) gives the source; none where all are one heading."""
    scale, cell = scale_of(T), pair.reference.cell_m
    yaws = [yaw for yaw, _ in hypotheses(pair.half_m, cell, replace(prior, sigma_scale=0.0))]
    box = _box(pair, T, prior)
    if box is None or not away(np.array(yaws), yaw_of(T), apart_rad(pair)).any():
        return Headings(np.zeros(0), np.zeros(0), np.zeros((0, 2)), False)
    pairs = [(yaw, scale) for yaw in yaws]
    reach = reach_of(pair, pairs)
    correlator = HeightCorrelator(pair.reference_relief, box, (-reach, -reach, reach, reach), len(pairs))
    u, v = np.arange(box[0], box[2] + 1), np.arange(box[1], box[3] + 1)[:, None]
    middle = pair.reference.cells_of(pair.centre_m[:2])
    farther = of_place(cell * (u - middle[0]), cell * (v - middle[1]), prior)
    score, at = [], []
    for yaw in yaws:
        t = template(pair.source_relief, pair.centre_m, yaw, scale, cell, reach)
        found = correlator.scores([replace(t, handicap=of_turn(yaw, scale, prior))]).score
        found = np.where(found > NO_SCORE, found - farther, NO_SCORE)
        row, col = np.unravel_index(int(np.argmax(found)), found.shape)
        score.append(float(found[row, col]))
        at.append(pair.reference.corner_m + cell * (np.array([box[0] + col, box[1] + row]) + 0.5))
    step = yaws[1] - yaws[0]
    return Headings(np.array(yaws), np.array(score), np.array(at), yaws[0] + 2 * math.pi - yaws[-1] < 1.5 * step)


def starts(pair: Pair, T: FloatArray, headings: Headings, most: int) -> list[FloatArray]:
    """(4, 4) Where to start a refinement at other headings than T's, best first."""
    peak = np.flatnonzero(headings.away_from([yaw_of(T)], apart_rad(pair)))
    best = peak[np.argsort(-headings.score[peak], kind="stable")][:most]
    shifts = np.column_stack([headings.at_m[best] - pair.centre_m[:2], np.zeros(len(best))])
    return [about(pair.centre_m, float(headings.yaw_rad[k]), scale_of(T), s) for k, s in zip(best, shifts, strict=True)]


def apart_rad(pair: Pair) -> float:
    """Two headings are two where they put the source's edge as far apart as two places are."""
    return min(APART_M / pair.half_m, MOST_APART_RAD)


def away(yaw_rad: FloatArray, from_rad: float, least_rad: float) -> Mask:
    """Which headings are so far from one."""
    return np.asarray(np.abs(wrapped(yaw_rad - from_rad)) >= least_rad)


def are_two(pair: Pair, T: FloatArray, other: FloatArray) -> bool:
    """Whether two similarities (4, 4) put the source at two places, or at one with two headings."""
    return not _at_one_place(pair, T, other) or is_turned(pair, T, other, apart_rad(pair))


def is_turned(pair: Pair, T: FloatArray, other: FloatArray, least_rad: float) -> bool:
    """Whether two similarities (4, 4) put the source at one place with headings so far apart."""
    return _at_one_place(pair, T, other) and bool(away(np.array(yaw_of(T)), yaw_of(other), least_rad))


def wrapped(angle_rad: FloatArray) -> FloatArray:
    """To ±pi."""
    return np.asarray(np.mod(angle_rad + math.pi, 2 * math.pi) - math.pi, dtype=np.float64)


def _at_one_place(pair: Pair, T: FloatArray, other: FloatArray) -> bool:
    shift = moved(T, pair.centre_m) - moved(other, pair.centre_m)
    return math.hypot(shift[0], shift[1]) < APART_M


def _box(pair: Pair, T: FloatArray, prior: RegistrationPrior) -> tuple[int, int, int, int] | None:
    """Columns and rows of the cells that are one place with T's, as far as the prior reaches."""
    here = pair.reference.cells_of(moved(T, pair.centre_m)[:2])
    far, (low, high) = APART_M / pair.reference.cell_m, region(pair, prior)
    low, high = np.maximum(low, np.ceil(here - far).astype(int)), np.minimum(high, np.floor(here + far).astype(int))
    return None if (high < low).any() else (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
