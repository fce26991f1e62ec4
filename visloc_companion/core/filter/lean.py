"""Fixes that lean to one side again and again: odometry, which holds the velocity, errs in scale or heading beyond its claim.

Innovations of fixes, made white by their covariance, are averaged with exponential weights. While all is well the mean is near
zero; a velocity that is held wrong makes every fix come out on the same side, none of them odd by itself.
"""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.core.filter.propagation import N_STATES, ODOMETRY_HEADING, ODOMETRY_SCALE
from visloc_companion.types import FloatArray, Vec2

SHARE = 0.15
"""Weight of the latest fix: about a dozen count."""
LEAN_SIGMA = 4.5
"""So far from zero it is no chance: innovations of neighbouring fixes are not quite independent."""
DOUBT: FloatArray = np.zeros((N_STATES, N_STATES))
"""(17, 17) covariance that is added then: 5 % of scale and 3 degrees of heading, which the next fixes learn."""
DOUBT[ODOMETRY_SCALE, ODOMETRY_SCALE], DOUBT[ODOMETRY_HEADING, ODOMETRY_HEADING] = 0.05**2, math.radians(3.0) ** 2
UPRIGHT: Vec2 = (0.0, 0.0)


def whitened(innovation_m: FloatArray, S_m2: FloatArray) -> Vec2:
    """An innovation (2,) made white by its covariance (2, 2)."""
    (off_north, off_east), ((nn, ne), (_, ee)) = innovation_m.tolist(), S_m2.tolist()
    root, share = math.sqrt(nn), ne / nn  # Cholesky's decomposition
    return off_north / root, (off_east - share * off_north) / math.sqrt(ee - share * ne)


def leaning(lean: Vec2, white_ne: Vec2) -> Vec2:
    """The mean after a fix with this whitened innovation."""
    north, east = white_ne
    return (1 - SHARE) * lean[0] + SHARE * north, (1 - SHARE) * lean[1] + SHARE * east


def leans(lean: Vec2) -> bool:
    """Whether the mean is further from zero than independent fixes would have it."""
    return lean[0] ** 2 + lean[1] ** 2 > LEAN_SIGMA**2 * SHARE / (2 - SHARE)
