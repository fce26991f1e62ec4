"""What a registration claims of itself: the probability of being wrong, and a covariance that its errors keep to.

Fitted by `python -m benchmarks.calibrate_clouds` on the places and worlds named there; scored on others.
"""

from __future__ import annotations

import math
from dataclasses import fields

import numpy as np

from visloc_companion.errors import Reason
from visloc_companion.localise.registration.base import NotRegistered, Registered, RegistrationPrior
from visloc_companion.localise.registration.evidence import Evidence
from visloc_companion.localise.registration.refine import Refined
from visloc_companion.localise.verify import logistic
from visloc_companion.types import FloatArray

WEIGHTS = (-0.277, 5.54, 12.6, -0.484, -4.13, -0.575, 1.21, 3.0, 1.0, 0.5)
"""On `regressors`: log-odds of being right. Fitted on answers of the search; they fit those of the other methods as well, since
the evidence asks nothing of how a registration was found. The last three were set beside the others, which were
held; the last is less than half of what fits ask for, as few wrong places that lead were seen."""
USUAL_RARE, MOST_RARE, MOST_GROUND, MOST_LASTING = 0.75, 3.0, 12.0, 30.0
"""What is rare counts where it leads by more than the first, by so much at most; so many nats of the ground, and of the ground
that has not changed."""
SURE_RARE, SURE_GROUND = 1.5, 6.0
"""From either on, a place is no other one whatever else is as likely."""
POWER = 1.5
"""Of the scores. Their squares are the log-likelihoods of independent cells; how many cells are independent falls with the score,
as it does from a plantation to a lawn with a few trees."""
LEAST_LEAD, LEAST_JOINT_LEAD, LEAST_PARTS_LEAD = 0.04, 0.5, 0.0
"""A place that leads by less as a whole and by less by all looks at once, or whose parts lead by less, is no likelier than
another, whatever else speaks for it."""
USUAL_RELIEF = (0.19, 2.6)
"""Of the source's relief over the reference's: twice beyond that of 99 % of the right places that the claims were fitted on,
where a single thing in one of the two makes the correlation, or noise."""
LEAST_RELIEF_M = 0.01
"""Less relief is none."""
MOST_CHI2 = 30.0
"""A place farther from the prior is not believed: twice as far as the farthest right one that the claims were fitted on."""
WRONG_SHARE = 0.15
"""Of answers whose right place was among those compared, as for the fit: 113 of 785 in the table of benchmarks/clouds.py."""
MOST_BOWL_M, MOST_SIGMA_M = 1.5, 3.0
"""Beyond these, a cloud bent more, or a place held more loosely, is not likelier to be wrong."""
FLOOR_M = (0.05, 0.08)
HEIGHT_SHARE = 0.22
"""Sigmas: the refinement's, a floor (horizontal, vertical), and of the height a share of the heights' deviation: crowns that are
lower in one cloud than in the other."""
FLAT_M, LOOSE_M, CLEAR_LEAD = 0.1, 1.5, 0.1
"""A refusal is for want of texture where the relief is flatter or the place looser, else ambiguous where another is as good, else
for the distance from the prior where that is too large."""


def regressors(e: Evidence) -> tuple[float, ...]:
    """What the log-odds are linear in: the lead, that by all looks at once, how far the place is from the prior, how much the
    cloud is bent to fit, how loosely it is held, how much of the source agrees, how rare that is, the lead of the ground and that
    of the ground that has not changed."""
    far, bent, held = min(e.prior_chi2, MOST_CHI2), min(abs(e.bowl_m), MOST_BOWL_M), min(e.formal_sigma_m, MOST_SIGMA_M)
    beyond_usual = min(max(rare(e) - USUAL_RARE, 0.0), MOST_RARE)
    return (1.0, lead(e), e.joint_lead, far, bent, held, e.blocks, beyond_usual, ground(e), lasting(e))


def lead(e: Evidence) -> float:
    """How much likelier the place is than its rivals: the mean of all other places and those that were refined as it was."""
    own, rival, refined = (math.pow(max(s, 0.0), POWER) for s in (e.score, e.rival, e.refined_rival))
    return own - 0.5 * (rival + refined)


def rare(e: Evidence) -> float:
    """How much more rarely than elsewhere parts agree so by chance, as far as they lie on the reference."""
    return e.rare_lead * e.overlap


def ground(e: Evidence) -> float:
    """By how many nats the ground tells the place; 0 where the place is held loosely, for the ground tells it to some metres."""
    return min(e.ground_lead, MOST_GROUND) if e.formal_sigma_m <= LOOSE_M else 0.0


def lasting(e: Evidence) -> float:
    """By how many nats the ground that has not changed tells the place."""
    return min(e.lasting_lead, MOST_LASTING)


def unlike(e: Evidence) -> bool:
    """Whether one relief is much larger than the other."""
    ratio = max(e.source_relief_m, LEAST_RELIEF_M) / max(e.relief_m, LEAST_RELIEF_M)
    return not USUAL_RELIEF[0] <= ratio <= USUAL_RELIEF[1]


def probability_wrong(e: Evidence) -> float:
    """Calibrated probability of being off by more than 5 m horizontally."""
    return at_least(logistic(-float(np.dot(WEIGHTS, regressors(e)))), e)


def at_least(wrong: float, e: Evidence) -> float:
    """The probability in view of what could not be compared; at least a half where another place is as likely, by the whole and
    all looks at once or by the parts, unless what agrees is too rare for that or the ground tells, the place is far from the
    prior, or the reliefs are too unlike or may be steps of rounded heights."""
    wrong = in_view_of_unseen(wrong, e.unseen)
    ambiguous = (lead(e) < LEAST_LEAD and e.joint_lead < LEAST_JOINT_LEAD) or e.parts_lead < LEAST_PARTS_LEAD
    ambiguous &= rare(e) < SURE_RARE and ground(e) < SURE_GROUND
    return max(wrong, 0.5) if ambiguous or e.prior_chi2 > MOST_CHI2 or unlike(e) or e.terraced else wrong


def in_view_of_unseen(wrong: float, unseen: float) -> float:
    """A probability of being wrong that was fitted where the right place was among those compared, where it is not with the
    probability `unseen`: what is found then is wrong, and looks as another place does (Bayes' rule)."""
    likelier_wrong = WRONG_SHARE + unseen * (1 - WRONG_SHARE)
    right = (1 - wrong) * (1 - unseen) * WRONG_SHARE
    return wrong * likelier_wrong / (wrong * likelier_wrong + right)


def answer(refined: Refined, e: Evidence, prior: RegistrationPrior, max_probability_wrong: float) -> Registered | NotRegistered:
    """The registration with its claims, or the refusal where it is wrong with more than the given probability."""
    wrong = probability_wrong(e)
    if wrong > max_probability_wrong:
        return _refused(e, wrong)
    formal = np.zeros((3, 3))
    formal[:2, :2], formal[2, 2] = refined.placed[:2, :2], refined.raised[0, 0]
    spread = formal + np.diag(_floor_m2(e, prior))
    yaw, scale = (math.sqrt(refined.placed[k, k]) for k in (2, 3))
    return Registered(refined.T, spread, min(yaw, prior.sigma_yaw_rad), min(scale, prior.sigma_scale), wrong, e.named())


def doubted(registered: Registered) -> NotRegistered:
    """The refusal that an answer would have been, had it not been asked for in spite of what it claims.

    Of what a method of one's own names as evidence, no reason but that it does not match is read.
    """
    wrong, named = registered.probability_wrong, dict(registered.evidence)
    own = {f.name for f in fields(Evidence)}
    if not own <= set(named):
        return NotRegistered(Reason.NO_MATCH, f"wrong with a probability of {wrong:.3f}", registered.evidence)
    return _refused(Evidence(**{name: value for name, value in named.items() if name in own}), wrong)


def _refused(e: Evidence, wrong: float) -> NotRegistered:
    reason, what = _reason(e), f"wrong with a probability of {wrong:.3f}"
    if reason is Reason.INCONSISTENT_WITH_PRIOR:
        what += f", {math.sqrt(e.prior_chi2):.0f} sigma from the prior: heights of another datum, another unit or heading?"
    return NotRegistered(reason, what, (*e.named(), ("probability_wrong", wrong)))


def _floor_m2(e: Evidence, prior: RegistrationPrior) -> FloatArray:
    height = (HEIGHT_SHARE * e.deviation_m) ** 2 + FLOOR_M[1] ** 2 + prior.sigma_growth_m**2
    return np.array([FLOOR_M[0] ** 2, FLOOR_M[0] ** 2, height])


def _reason(e: Evidence) -> Reason:
    """Which of the evidence is worst."""
    if e.relief_m < FLAT_M or e.formal_sigma_m > LOOSE_M or e.terraced:
        return Reason.LOW_TEXTURE
    if e.score - e.rival < CLEAR_LEAD:
        return Reason.AMBIGUOUS
    return Reason.INCONSISTENT_WITH_PRIOR if e.prior_chi2 > MOST_CHI2 else Reason.NO_MATCH
