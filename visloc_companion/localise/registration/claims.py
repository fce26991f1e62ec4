"""What a registration claims of itself: the probability of being wrong, and a covariance that its errors keep to.

Fitted by `python -m benchmarks.calibrate_clouds` on the places named there; scored on other places.
"""

from __future__ import annotations

import math
from dataclasses import fields

import numpy as np

from visloc_companion.errors import Reason
from visloc_companion.localise.registration.base import NotRegistered, Registered, RegistrationPrior
from visloc_companion.localise.registration.evidence import Evidence
from visloc_companion.localise.registration.refine import Refined
from visloc_companion.types import FloatArray

WEIGHTS = (-0.686, 59.8, -0.442)
"""On `regressors`: log-odds of being right. Fitted on answers of the search; they fit those of the other methods as well, since
the evidence asks nothing of how a registration was found."""
POWER = 1.5
"""Of the scores. Their squares are the log-likelihoods of independent cells; how many cells are independent falls with the score,
as it does from a plantation to a lawn with a few trees."""
MOST_CHI2 = 30.0
"""Beyond this, farther from the prior is not likelier to be wrong."""
FLOOR_M = (0.05, 0.08)
HEIGHT_SHARE = 0.22
"""Sigmas: the refinement's, a floor (horizontal, vertical), and of the height a share of the heights' deviation: crowns that are
lower in one cloud than in the other."""
FLAT_M, LOOSE_M, CLEAR_LEAD = 0.1, 1.5, 0.1
"""A refusal is for want of texture where the relief is flatter or the place looser, else ambiguous where another is as good."""


def regressors(e: Evidence) -> tuple[float, ...]:
    """What the log-odds are linear in: how much likelier the place is than its rival, and how far it is from the prior."""
    return (1.0, max(e.score, 0.0) ** POWER - e.rival**POWER, min(e.prior_chi2, MOST_CHI2))


def probability_wrong(e: Evidence) -> float:
    """Calibrated probability of being off by more than 5 m horizontally."""
    odds = float(np.dot(WEIGHTS, regressors(e)))
    return 1 / (1 + math.exp(min(max(odds, -50), 50)))


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
    if not {f.name for f in fields(Evidence)} <= set(named):
        return NotRegistered(Reason.NO_MATCH, f"wrong with a probability of {wrong:.3f}", registered.evidence)
    return _refused(Evidence(**named), wrong)


def _refused(e: Evidence, wrong: float) -> NotRegistered:
    return NotRegistered(_reason(e), f"wrong with a probability of {wrong:.3f}", (*e.named(), ("probability_wrong", wrong)))


def _floor_m2(e: Evidence, prior: RegistrationPrior) -> FloatArray:
    height = (HEIGHT_SHARE * e.deviation_m) ** 2 + FLOOR_M[1] ** 2 + prior.sigma_growth_m**2
    return np.array([FLOOR_M[0] ** 2, FLOOR_M[0] ** 2, height])


def _reason(e: Evidence) -> Reason:
    """Which of the evidence is worst."""
    if e.relief_m < FLAT_M or e.formal_sigma_m > LOOSE_M:
        return Reason.LOW_TEXTURE
    return Reason.AMBIGUOUS if e.score - e.rival < CLEAR_LEAD else Reason.NO_MATCH
