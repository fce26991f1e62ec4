"""What all methods look at: the surfaces of source and reference on cells of one size."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from visloc_companion.errors import Reason
from visloc_companion.localise.registration.base import NotRegistered, RegistrationPrior
from visloc_companion.localise.registration.clouds import (
    FEWEST_POINTS,
    UP,
    checked,
    density_per_m2,
    middle_m,
    within,
    without_strays,
)
from visloc_companion.localise.registration.height_map import HeightMap, high_passed, smoothed, upper_surface
from visloc_companion.localise.registration.sampling import Sampling, sampling_of
from visloc_companion.types import FloatArray

FINEST_PART_M = 0.5
"""Side of a cell's parts: finer is not seen by stereo from 90 m; of the reference no less than the distance of its points. Those
of the source lie on the surface already, however few there are."""
USUAL_CELL_M = 1.0
LEAST_CELL_M = 0.9
"""A cell is a whole number of parts, about the usual side and not below the least."""
MOST_CELLS = 2048
"""A source or reference wider than this many cells gets coarser ones."""
MOST_PARTS = 4096
"""Wider than this many parts, it gets coarser ones of these as well: maps of parts are what memory goes to."""
SMOOTHING_CELLS = 0.6
STRAY_SHARE = 0.05
"""Source points farther out than this share of the width of 99.8 % of them are strays."""
FINE_M, FINE_CELLS = 2.0, 1.0
"""The finer relief is what stands out of a Gaussian mean of this sigma, at least so many cells."""
GENTLE_M = 2.0
"""Sigma of the mean of the heights that slopes of the ground are taken from."""
ROUNDED = 1e-6
SIGMAS = 3.0
"""The prior is searched, and the reference looked at, so far."""


@dataclass(frozen=True, eq=False)
class Pair:
    """Points in metres, `reference_m` only what the prior reaches; smoothed surfaces and what stands out of them (`relief`).

    `centre_m` (3,) is the source's middle, about which it is turned and scaled; `strays` the numbers of points of source and of
    reference that were left out (clouds.without_strays), `sampling` how the two were sampled.
    """

    source_m: FloatArray
    reference_m: FloatArray
    centre_m: FloatArray
    source: HeightMap
    reference: HeightMap
    source_relief: HeightMap
    reference_relief: HeightMap
    sampling: tuple[Sampling, Sampling]
    strays: tuple[int, int] = (0, 0)

    @property
    def half_m(self) -> float:
        """Half the longer side of the source."""
        return float(0.5 * self.source.cell_m * max(self.source.known.shape))

    @cached_property
    def finer(self) -> Pair:
        """With the finer reliefs."""
        sigma_m = max(FINE_M, FINE_CELLS * self.reference.cell_m)
        source, reference = (high_passed(of, sigma_m) for of in (self.source, self.reference))
        return replace(self, source_relief=source, reference_relief=reference)

    @cached_property
    def gentle(self) -> tuple[HeightMap, HeightMap]:
        """Source and reference as the means that slopes of the ground are taken from."""
        return smoothed(self.source, GENTLE_M), smoothed(self.reference, GENTLE_M)


def make_pair(source_m: FloatArray, reference_m: FloatArray, prior: RegistrationPrior) -> Pair | NotRegistered:
    """The pair, or why there is none. Raises ValueError as base.RegistrationMethod."""
    source, reference = checked(source_m, "source"), checked(reference_m, "reference")
    strays = [0, 0]
    if len(source) >= FEWEST_POINTS:
        given = len(source)
        source = without_strays(source)
        strays[0] = given - len(source)
        low, high = np.percentile(source[:, :2], [0.1, 99.9], axis=0)
        source = within(source, low, high, STRAY_SHARE)
        reach = SIGMAS * prior.sigma_horizontal_m + (0.5 + STRAY_SHARE) * float(np.hypot(*(high - low)))
        centre = middle_m(source)
        reference = within(reference, centre[:2] - reach, centre[:2] + reach)
        given = len(reference)
        reference = without_strays(reference, (UP,))
        strays[1] = given - len(reference)
    if len(source) < FEWEST_POINTS:
        return NotRegistered(Reason.TOO_FEW_FEATURES, f"the source has {len(source)} points, fewer than {FEWEST_POINTS}")
    if len(reference) < FEWEST_POINTS:
        what = f"the reference has {len(reference)} points where the prior reaches, fewer than {FEWEST_POINTS}"
        return NotRegistered(Reason.OUTSIDE_MAP, what)
    density, sampling = density_per_m2(reference), (sampling_of(source), sampling_of(reference))
    source, reference = (s.spread(points) for s, points in zip(sampling, (source, reference), strict=True))
    side = max(float(np.ptp(points[:, :2], axis=0).max()) for points in (source, reference))
    finest = max(FINEST_PART_M, side / MOST_PARTS)
    part = _part_m(1 / math.sqrt(density), finest, sampling[1].spacing_m)
    parts = max(1, round(USUAL_CELL_M / part), math.ceil(side / (MOST_CELLS * part)))
    cell = max(part * parts, LEAST_CELL_M)
    surfaces = [upper_surface(source, cell, max(1, int(cell / finest))), upper_surface(reference, cell, parts)]
    smooth = [smoothed(surface, SMOOTHING_CELLS * cell) for surface in surfaces]
    of_source, of_reference = smooth
    reliefs = high_passed(of_source), high_passed(of_reference)
    return Pair(source, reference, centre, of_source, of_reference, *reliefs, sampling, strays=(strays[0], strays[1]))


def _part_m(spacing_m: float, finest_m: float, step_m: float) -> float:
    """The side of a part, at least the finest: about the points' spacing, of a raster whole steps. In cells of 1.02 m samples a
    metre apart would lie half a cell to one side here and to the other there."""
    if not step_m:
        return max(finest_m, spacing_m)
    return step_m * max(round(spacing_m / step_m), math.ceil(finest_m / step_m - ROUNDED))
