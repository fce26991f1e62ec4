"""By how much a velocity that rests on our fixes errs more than the model says, learned where fixes are rare.

The error of an autopilot's velocity is that of accelerations, which nothing but our fixes corrects. Between two fixes it is sent
what that same velocity made of the last one, and learns nothing. A correction that is small it takes for motion, so that our
position's error becomes one of its velocity; a large one is a reset, which leaves its velocity as it was. With four fixes a
second that is little. Where they are rare one error lasts from fix to fix: it goes with our position's, and is no process of its
own that forgets itself in 20 s.

Correcting it would feed our fixes back into their own source (fusion.py), but their innovations tell how large it is (covariance
matching: Mehra, "Approaches to adaptive filtering", 1972), where more than half of what they should be is the velocity's: else
they tell of the fix. The variance is raised until they are as large as it says, and never lowered below the model's.
"""

from __future__ import annotations

import math

from visloc_companion.core.filter.propagation import VELOCITY
from visloc_companion.types import FloatArray

GAIN = 0.3
"""Of the factor's logarithm, for each fix: three of them must do, for there is one in several seconds."""
FORGOTTEN_S = 20.0
"""Fixes that come often hold the velocity: what was learned goes by."""
CHANCE = 1.5
"""Mean square that honest velocities come to by chance."""
LEAST_SHARE = 0.5
MOST = 36.0
MOST_SQUARED = 8.0
"""No fix counts for more: one that is wrong says nothing of the velocity."""


def learned(over: float, squared: float, P: FloatArray, S: FloatArray, since_s: float) -> float:
    """By what factor, at least 1, the variance of the velocity's error is larger than the model says, after a fix that was taken.

    `over`: what it was before; `squared`: the fix's normalised squared innovation over its degrees of freedom; P (17, 17): the
    filter's covariance before the fix; S (2, 2): the innovation's; `since_s`: the time since the last fix.
    """
    (north_m2ps2, _), (_, east_m2ps2) = P[VELOCITY, VELOCITY].tolist()
    (north_m2, _), (_, east_m2) = S.tolist()
    by_velocity = since_s**2 * (north_m2ps2 + east_m2ps2)
    if by_velocity < LEAST_SHARE * (north_m2 + east_m2):
        return max(1.0, over * math.exp(-since_s / FORGOTTEN_S))
    return min(max(over * math.exp(GAIN * (min(squared, MOST_SQUARED) / CHANCE - 1)), 1.0), MOST)
