"""What a Gaussian prior takes from the score of a place: scores of another place are then compared by how likely each is.

Scores are not log-likelihoods, but the odds of being right grow with the lead of one over the next by a fitted factor
(structure/claims.py); half the squared distance from the prior, over the same factor, is on the scale of scores.
"""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.similarity import moved, scale_of, yaw_of
from visloc_companion.types import FloatArray

NATS = 60.0
"""Log-odds that a lead of 1 in the score is worth."""
LEAST_SIGMA = 1e-9


def of_place(east_m: FloatArray, north_m: FloatArray, prior: RegistrationPrior) -> Float32Array:
    """Of a shift from the prior's place, broadcast; 0 where the prior is not Gaussian."""
    square = np.square(east_m) + np.square(north_m)
    weight = 0.5 / NATS / max(prior.sigma_horizontal_m, LEAST_SIGMA) ** 2 if prior.gaussian else 0.0
    return np.asarray(weight * square, dtype=np.float32)


def of_turn(yaw_rad: float, scale: float, prior: RegistrationPrior) -> float:
    """Of a heading and a scale; 0 where the prior is not Gaussian."""
    if not prior.gaussian:
        return 0.0
    sigmas = (max(prior.sigma_yaw_rad, LEAST_SIGMA), max(prior.sigma_scale, LEAST_SIGMA))
    return 0.5 / NATS * ((yaw_rad / sigmas[0]) ** 2 + (math.log(scale) / sigmas[1]) ** 2)


def of_similarity(T: FloatArray, centre_m: FloatArray, prior: RegistrationPrior) -> float:
    """Of all of these, where T takes the source's middle."""
    shift = moved(T, centre_m) - centre_m
    return float(of_place(shift[0], shift[1], prior)) + of_turn(yaw_of(T), scale_of(T), prior)
