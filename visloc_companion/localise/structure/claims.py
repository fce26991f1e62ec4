"""How far the place of a stereo cloud is to be believed.

The registration's own claim is fitted on clouds of lasers, whose reliefs agree better than that of a stereo cloud ever does with
a surface of another season: it refuses places that are right. This one is fitted on stereo clouds, from the same evidence.
"""

from __future__ import annotations

import math
from dataclasses import replace

from visloc_companion.errors import Reason
from visloc_companion.localise.registration.base import NotRegistered, Registered
from visloc_companion.localise.registration.handicap import NATS
from visloc_companion.localise.registration.refine import SIGMA_BOWL_M

WEIGHTS = (-2.5, NATS)
"""On 1 and the lead over the next place, each less its handicap: log-odds of being right (off by less than 5 m). The slope is the
one of the handicap, so that distance from the prior and agreement are weighed alike; the constant is the likeliest one on answers
over seeds 30 to 47 of benchmarks/structure_chain.py, whose wrong ones lead by 0.06 at most."""
LOOSE_M = 0.45
"""A place that the reliefs hold no better than this is one among many, however far it leads. Of 128 flights over seeds 30 to 47
all seven wrong places were held to more than 0.6 m, and no right one; of 96 flights of eight frames over seeds 200 to 205 all
that are off by less than 1.3 m to 0.20 m or better."""
MOST_BOWL_M = 3 * SIGMA_BOWL_M
"""A cloud that would have to be bent by more lies over other ground. Of 93 right places over seeds 100 to 104 and 110 to 114 of
benchmarks/structure_chain.py none is bent by more than 1.1 m."""


def judged(registered: Registered, max_probability_wrong: float) -> Registered | NotRegistered:
    """The registration with the probability of being wrong, or the refusal where that is too much."""
    evidence = dict(registered.evidence)
    lead = evidence["correlation"] * math.sqrt(evidence["overlap"]) - evidence["handicap"] - evidence["refined_rival"]
    odds = WEIGHTS[0] + WEIGHTS[1] * lead
    wrong = 1 / (1 + math.exp(min(max(odds, -50.0), 50.0)))
    named = (*registered.evidence, ("probability_wrong", wrong))
    if evidence["formal_sigma_m"] > LOOSE_M:
        what = f"the reliefs hold the place to {evidence['formal_sigma_m']:.1f} m only"
        return NotRegistered(Reason.LOW_TEXTURE, what, named)
    if abs(evidence["bowl_m"]) > MOST_BOWL_M:
        what = f"the cloud fits where it is bent by {evidence['bowl_m']:.1f} m only"
        return NotRegistered(Reason.INCONSISTENT_WITH_PRIOR, what, named)
    if wrong <= max_probability_wrong:
        return replace(registered, probability_wrong=wrong)
    return NotRegistered(Reason.AMBIGUOUS, f"wrong with a probability of {wrong:.3f}, {lead:.2f} before the next place", named)
