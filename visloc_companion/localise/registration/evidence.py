"""What is known of a registration once it is found: how well the reliefs agree, what else fits, and what holds it in place."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields

import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.clouds import UP
from visloc_companion.localise.registration.handicap import of_similarity
from visloc_companion.localise.registration.leads import leads_of
from visloc_companion.localise.registration.pair import Pair
from visloc_companion.localise.registration.refine import Refined
from visloc_companion.localise.registration.similarity import moved, scale_of, yaw_of
from visloc_companion.localise.registration.surfaces import SourceCells, Surface, met
from visloc_companion.types import FloatArray

BLOCKS = 5
"""Blocks along each side of the source."""
FEWEST_IN_BLOCK = 12
BLOCK_AGREES = 0.3
"""Correlation of a block's relief from which it agrees."""
LEAST_VARIANCE_M2 = 1e-6
LEAST_STEPS = 1.5
"""Sigmas of their rounding. Of 40 cases in gullies and on a lawn (seed 502) with heights in steps of 0.5 or 1 m, those that were
off by more than 0.8 of their level had a relief of 0.9 to 1.25 of these, one of 1.6."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """`correlation` of the reliefs where both are known, `overlap`: share of the source that this is; `rival`: the best score
    (correlation times the root of the overlap) of another place, at least 6 m away, or of this one turned by as much at its edge;
    `blocks`: share of the source's blocks that agree, by relief; `formal_sigma_m`: worst horizontal sigma of the refinement and
    of what agrees beside it (nearby.py),
    `deviation_m` of its height differences, `relief_m` of the reference's relief there; `bowl_m` that was taken out;
    `prior_chi2`: squared distance of place, height, heading and scale from the prior in sigmas; `handicap` (handicap.py) of that
    but the height, which a rival's score lacks as well;
    `refined_rival` is `rival` but of refined places by their score after that, as this one's is;
    `source_relief_m` is `relief_m` of the source, on the same cells; `parts_lead`, `joint_lead` and `rare_lead` as leads.Leads;
    `unseen` as correlation.Scores;
    `source_strays` and `reference_strays`: numbers of points that were left out (pair.Pair); `rounding_m`: sigma of what heights
    in steps are off by, in the cloud that has the larger ones; `ground_lead`: nats by which the slopes of the ground make the
    place likelier than any other, 0 where they were not asked (choice.Choice); `blocks_lead`: nats by which the blocks that have
    not changed make it likelier than what lies 2.5 to 6 m beside (nearby.of_blocks), 0 where they were not asked; `lasting_lead`:
    as `ground_lead`, by the ground that has not changed, cell by cell (lasting.Lasting); `unchanged_lead`: nats by which all that
    has not changed makes it likelier than any other place (unchanged.Unchanged), 0 where there was no doubt."""

    correlation: float
    overlap: float
    rival: float
    blocks: float
    formal_sigma_m: float
    deviation_m: float
    relief_m: float
    bowl_m: float
    prior_chi2: float
    handicap: float = 0.0
    refined_rival: float = 0.0
    source_relief_m: float = 0.0
    parts_lead: float = 0.0
    unseen: float = 0.0
    source_strays: float = 0.0
    reference_strays: float = 0.0
    rounding_m: float = 0.0
    joint_lead: float = 0.0
    rare_lead: float = 0.0
    ground_lead: float = 0.0
    blocks_lead: float = 0.0
    lasting_lead: float = 0.0
    unchanged_lead: float = 0.0

    @property
    def terraced(self) -> bool:
        """Whether a relief may be the steps of heights that were rounded: two clouds in whole metres agree where their steps lie
        alike, which is beside the place."""
        return min(self.relief_m, self.source_relief_m) < LEAST_STEPS * self.rounding_m

    @property
    def score(self) -> float:
        """Comparable with `rival`."""
        return self.correlation * math.sqrt(self.overlap) - self.handicap

    def named(self) -> tuple[tuple[str, float], ...]:
        """As base.Registered carries it."""
        return tuple((f.name, float(v)) for f, v in zip(fields(self), astuple(self), strict=True))


@dataclass(frozen=True, slots=True)
class Agreement:
    """Of the reliefs at a registration: `correlation`, `overlap`, share of `blocks` that agree, deviation of the reference's
    (`relief_m`) and the source's; `handicap` of its distance from the prior."""

    correlation: float
    overlap: float
    blocks: float
    relief_m: float
    source_relief_m: float
    handicap: float

    @property
    def score(self) -> float:
        """Correlation times the root of the overlap, less the handicap."""
        return self.correlation * math.sqrt(self.overlap) - self.handicap


def agreement(pair: Pair, source: SourceCells, relief: Surface, T: FloatArray, prior: RegistrationPrior) -> Agreement:
    """How well the source's relief agrees with the reference's after T."""
    on = met(source, relief, T)
    if len(on.at_m) < FEWEST_IN_BLOCK:
        return Agreement(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    a, b = source.relief_m[on.used], on.height_m
    off = (source.points_m[on.used, :2] - pair.centre_m[:2]) / (2 * pair.half_m) + 0.5
    block = np.clip((off * BLOCKS).astype(int), 0, BLOCKS - 1) @ np.array([BLOCKS, 1])
    each, deviation = _correlations(a, b, block)
    blocks = float(deviation @ (each > BLOCK_AGREES) / max(float(deviation.sum()), 1e-9))
    whole, _ = _correlations(a, b, np.zeros(len(a), np.int64))
    handicap = of_similarity(T, pair.centre_m, prior)
    return Agreement(float(whole[0]), float(on.used.mean()), blocks, float(b.std()), float(a.std()), handicap)


def evidence_of(
    pair: Pair,
    found: Agreement,
    refined: Refined,
    rivals: tuple[float, float],
    turned: Sequence[FloatArray],
    unseen: float,
    prior: RegistrationPrior,
) -> Evidence:
    """All that is known of one registration. `rivals`: Evidence's `rival` and `refined_rival`; `turned`: similarities (4, 4) of
    the same place with another heading, which leads.py looks at too."""
    horizontal = np.linalg.eigvalsh(refined.placed[:2, :2])
    leads = leads_of(pair, refined.T, prior, turned)
    return Evidence(
        found.correlation,
        found.overlap,
        rivals[0],
        found.blocks,
        math.sqrt(max(0.0, float(horizontal[-1]))),
        refined.height_sigma_m,
        found.relief_m,
        refined.bowl_m,
        prior_chi2(refined.T, pair.centre_m, prior),
        found.handicap,
        rivals[1],
        found.source_relief_m,
        leads.parts,
        unseen,
        float(pair.strays[0]),
        float(pair.strays[1]),
        math.sqrt(max(float(s.unknown_m2[UP]) for s in pair.sampling)),
        leads.joint,
        leads.rare,
    )


def prior_chi2(T: FloatArray, centre_m: FloatArray, prior: RegistrationPrior) -> float:
    """Squared distance (five degrees of freedom) of a similarity from the prior; growth is no distance."""
    shift = moved(T, centre_m) - centre_m
    height = math.hypot(prior.sigma_vertical_m, prior.sigma_growth_m)
    off = [*shift, yaw_of(T), math.log(scale_of(T))]
    sigmas = [prior.sigma_horizontal_m, prior.sigma_horizontal_m, height, prior.sigma_yaw_rad, prior.sigma_scale]
    return float(sum((o / max(s, 1e-9)) ** 2 for o, s in zip(off, sigmas, strict=True)))


def _correlations(a: FloatArray, b: FloatArray, group: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """Correlation of a and b in each group of enough values, and the deviation of a there."""
    n = np.bincount(group)
    enough = n >= FEWEST_IN_BLOCK
    sa, sb, sab, saa, sbb = (np.bincount(group, values)[enough] / n[enough] for values in (a, b, a * b, a * a, b * b))
    var_a, var_b = np.maximum(saa - sa * sa, LEAST_VARIANCE_M2), np.maximum(sbb - sb * sb, LEAST_VARIANCE_M2)
    return (sab - sa * sb) / np.sqrt(var_a * var_b), np.sqrt(var_a)
