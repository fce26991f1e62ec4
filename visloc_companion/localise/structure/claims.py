"""How far the place of a stereo cloud is to be believed.

The registration's own claim is fitted on clouds of lasers, whose reliefs agree better than that of a stereo cloud ever does with
a surface of another season: it refuses places that are right. This one is fitted on stereo clouds, from the same evidence.
"""

from __future__ import annotations

import math
from dataclasses import replace

from visloc_companion.errors import Reason
from visloc_companion.localise.registration.base import NotRegistered, Registered
from visloc_companion.localise.registration.claims import in_view_of_unseen
from visloc_companion.localise.registration.handicap import NATS
from visloc_companion.localise.registration.refine import SIGMA_BOWL_M
from visloc_companion.localise.registration.unchanged import WORTH

WEIGHTS = (-2.5, NATS)
"""On 1 and the lead over the next place, each less its handicap: log-odds of being right (off by less than 5 m). The slope is the
one of the handicap, so that distance from the prior and agreement are weighed alike; the constant is the likeliest one on answers
over seeds 30 to 47 of benchmarks/structure_chain.py, whose wrong ones lead by 0.06 at most."""
ENOUGH_NATS = 16.0
"""By so much at least the blocks that have not changed make a right place likelier than those a few metres beside; what is
missing is taken from the log-odds. Where nothing is as it was blocks lead by chance: of 176 flights over bare, snowy and
changed land (seeds 30 to 45) the ten wrong places lead by 9 nats at most, and 98 % of the 159 right ones by 16 or more; a place
10 m off that led all others by 0.15 (seed 131 of benchmarks/changed_land.py) leads those beside it by 9."""
HELD_M, NATS_PER_M, LOOSE_M = 0.45, 6.0, 0.8
"""A place is one among many where the reliefs hold it loosely, however far it leads: beyond the first it is less likely right by
so much a metre, and beyond the last it is not believed. Of 186 answers over bare, snowy and changed land (seeds 30 to 39 and 100
to 104, flights of `stale_map`) 143 are accepted so, none wrong and one off by more than 2 m; 134 with a limit of 0.45 m alone.
Without any of it two wrong ones would be: 21 m off, held to 0.98 m, and 13.5 m off, held to 0.60 m."""
LEAST_OVERLAP = 0.6
"""Where less of a cloud lies over the map, what would speak against a place may lie beyond the edge. A vehicle on its way back
over the edge believed a place 11 m off, with 46 % of its cloud on the map, claimed 0.001 (scenario `map_edge`); of 124 answers
over seeds 30 to 39 and 100 to 104 each had all of it there."""
MOST_BOWL_M = 3 * SIGMA_BOWL_M
"""A cloud that would have to be bent by more lies over other ground. Of 93 right places over seeds 100 to 104 and 110 to 114 of
benchmarks/structure_chain.py none is bent by more than 1.1 m."""
UNCHANGED = (-7.2, WORTH)
"""On 1 and the lead in nats of all that has not changed (registration/unchanged.py), where that was asked: log-odds. Half of
changed land's wrong answers and clouds over other ground lead by less than 10 nats and all by less than 34; clouds mirrored over
their own ground by 58 at most (benchmarks/changed_land.py, seeds 60 to 67, 150 to 159 and 161 to 166)."""
MOST_HELD_M = 2.0
"""A place that this tells is not believed where it is held more loosely: a dam does so to 2.5 m, an orchard to 3.5 m."""


def judged(registered: Registered, max_probability_wrong: float) -> Registered | NotRegistered:
    """The registration with the probability of being wrong, or the refusal where that is too much."""
    evidence = dict(registered.evidence)
    lead = evidence["correlation"] * math.sqrt(evidence["overlap"]) - evidence["handicap"] - evidence["refined_rival"]
    refused, told = _refused(evidence), _by_unchanged(evidence)
    odds = told if refused else max(_by_score(evidence, lead), told)
    wrong = in_view_of_unseen(1 / (1 + math.exp(min(max(odds, -50.0), 50.0))), evidence.get("unseen", 0.0))
    named = (*registered.evidence, ("probability_wrong", wrong))
    if evidence["overlap"] < LEAST_OVERLAP:
        return NotRegistered(Reason.OUTSIDE_MAP, f"the map knows the ground below {evidence['overlap']:.0%} of the cloud", named)
    if refused and (told == -math.inf or wrong > max_probability_wrong):
        return NotRegistered(*refused, named)
    if wrong <= max_probability_wrong:
        return replace(registered, probability_wrong=wrong)
    return NotRegistered(Reason.AMBIGUOUS, f"wrong with a probability of {wrong:.3f}, {lead:.2f} before the next place", named)


def _by_score(evidence: dict[str, float], lead: float) -> float:
    """Log-odds of being right by the lead of the score and the blocks."""
    loose = NATS_PER_M * max(evidence["formal_sigma_m"] - HELD_M, 0.0)
    lacking = max(ENOUGH_NATS - evidence["blocks_lead"], 0.0)
    return WEIGHTS[0] + WEIGHTS[1] * lead - loose - lacking


def _by_unchanged(evidence: dict[str, float]) -> float:
    """Log-odds of being right by the lead of all that has not changed; none where that was not asked, or holds it loosely."""
    lead = evidence.get("unchanged_lead", 0.0)
    if lead == 0.0 or evidence["formal_sigma_m"] > MOST_HELD_M:
        return -math.inf
    return UNCHANGED[0] + UNCHANGED[1] * lead


def _refused(evidence: dict[str, float]) -> tuple[Reason, str] | None:
    """Why the score is not believed, whatever it is."""
    if evidence["formal_sigma_m"] > LOOSE_M:
        return Reason.LOW_TEXTURE, f"the reliefs hold the place to {evidence['formal_sigma_m']:.1f} m only"
    if abs(evidence["bowl_m"]) > MOST_BOWL_M:
        return Reason.INCONSISTENT_WITH_PRIOR, f"the cloud fits where it is bent by {evidence['bowl_m']:.1f} m only"
    return None
