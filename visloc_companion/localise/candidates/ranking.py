"""Which of several refined candidates is the place: a conditional logit (McFadden 1974) on what is known of each.

A candidate's strength is in nats: the odds of two candidates are the exponential of the difference of their strengths.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

RankWeights = tuple[float, ...]
GRADIENT_RANK: RankWeights = (39.9, -4.99, 1.24, -0.533, 11.8, 2.41)
"""On `Standing.regressors` (`python -m benchmarks.rank`, training rows only) for gradient features, and ..."""
DEEP_RANK: RankWeights = (19.9, -8.23, 2.02, -0.964, 35.1, -17.0)
"""... for the network's."""
CLEAR_LEAD = 12.0
"""Lead (nats) of a candidate without rivals, and the greatest that is told apart."""


@dataclass(frozen=True, slots=True)
class Standing:
    """`score` and `coarse_score`: correlation after refinement and at the search level; `block_z`: agreeing blocks beyond chance
    in standard deviations; `prior_chi2`: squared distance from the prior in sigmas; `footprint_px`: side of the footprint."""

    score: float
    coarse_score: float
    block_z: float
    prior_chi2: float
    footprint_px: float

    def regressors(self) -> tuple[float, ...]:
        """What strengths are linear in."""
        size = math.log(self.footprint_px / 173)
        z = math.sqrt(max(0.0, self.block_z))
        return self.score, self.score * size, z, self.prior_chi2, self.coarse_score, self.coarse_score * size

    def strength(self, weights: RankWeights) -> float:
        """Nats."""
        return sum(w * v for w, v in zip(weights, self.regressors(), strict=True))


def lead(strengths: Sequence[float], best: int) -> float:
    """Log-odds (nats, at most CLEAR_LEAD) of one candidate against all others together."""
    rivals = [s - strengths[best] for k, s in enumerate(strengths) if k != best]
    if not rivals:
        return CLEAR_LEAD
    top = max(rivals)
    return min(CLEAR_LEAD, -top - math.log(sum(math.exp(r - top) for r in rivals)))
