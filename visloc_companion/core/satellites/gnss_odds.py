"""From the sequential tests to one probability that the reported position is false.

Prior: attacks begin at ATTACKS_PER_H while nothing is known, and may have done so for BEFORE_S when GNSS is first compared; one
that was lost comes back false with FALSE_RETURN, and after a disagreement with FALSE_AFTER_DISAGREEMENT; what a daemon finds that
is started in flight, where something ended the one before, is false with FALSE_FOUND_IN_FLIGHT. These are assumptions, not
measurements: see docs/gnss-verdict.md. The tests look for different shifts, so their statistics R (seconds) add up, and the
posterior odds are the rate times their sum.
"""

from __future__ import annotations

import math

ATTACKS_PER_H = 0.1
RATE_PER_S = ATTACKS_PER_H / 3600.0
FALSE_RETURN = 0.1
FALSE_AFTER_DISAGREEMENT = 0.5
FALSE_FOUND_IN_FLIGHT = FALSE_RETURN
DRAGGED_FROM_THERE_S = 300.0
"""What a drag weighs, in seconds, that leaves the truth as such a GNSS is first compared: one that began long before has it
elsewhere by then, like a step, and few begin just then (decision 91)."""
BEFORE_S = 30.0


def first_weight_s(probability: float) -> float:
    """The weight of a test's first start, in seconds, that gives a prior probability of "false from the beginning"."""
    return probability / (1 - probability) / RATE_PER_S


def found_in_flight_s() -> tuple[float, float]:
    """The weights of the first start of a GNSS that is found in flight, in seconds, for steps and for drags: their mean gives the
    prior probability, for as many steps are looked for as drags."""
    mean_s = first_weight_s(FALSE_FOUND_IN_FLIGHT)
    return 2 * mean_s - DRAGGED_FROM_THERE_S, DRAGGED_FROM_THERE_S


def log_r(probability: float) -> float:
    """The log R at which the posterior is a probability."""
    return math.log(first_weight_s(probability))


def probability_false(*log_r: float) -> float:
    """Posterior probability from the tests' log R; minus infinity says nothing."""
    top = max(log_r)
    if top == -math.inf:
        return 0.0
    log_odds = math.log(RATE_PER_S) + top + math.log(sum(math.exp(value - top) for value in log_r))
    return 1 / (1 + math.exp(-log_odds)) if log_odds > -700 else 0.0
