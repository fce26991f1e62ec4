"""How far the place of a stereo cloud is to be believed.

The registration's own claim is fitted on clouds of lasers, whose reliefs agree better than that of a stereo cloud ever does with
a surface of another season: it refuses places that are right. This one is fitted on stereo clouds, from the same evidence.
"""

from __future__ import annotations

import math
from dataclasses import replace

from visloc_companion.errors import Reason
from visloc_companion.localise.registration.base import NotRegistered, Registered

WEIGHTS = (1.0, 60.0, -0.44)
"""On 1, the lead over the next place, and the distance from the prior: log-odds of being right (off by less than 5 m). The slopes
are the registration's, which was fitted on more wrong places than the ten of 96 answers over seeds 30 to 37 of
benchmarks/structure_chain.py. The constant leaves those ten at 0.43 and more; the likeliest one (3.4) would nearly accept one."""
MOST_CHI2 = 30.0
"""Beyond this, farther from the prior is not likelier to be wrong."""


def judged(registered: Registered, max_probability_wrong: float) -> Registered | NotRegistered:
    """The registration with the probability of being wrong, or the refusal where that is too much."""
    evidence = dict(registered.evidence)
    lead = evidence["correlation"] * math.sqrt(evidence["overlap"]) - evidence["rival"]
    odds = WEIGHTS[0] + WEIGHTS[1] * lead + WEIGHTS[2] * min(evidence["prior_chi2"], MOST_CHI2)
    wrong = 1 / (1 + math.exp(min(max(odds, -50.0), 50.0)))
    if wrong <= max_probability_wrong:
        return replace(registered, probability_wrong=wrong)
    named = (*registered.evidence, ("probability_wrong", wrong))
    return NotRegistered(Reason.AMBIGUOUS, f"wrong with a probability of {wrong:.3f}, {lead:.2f} before the next place", named)
