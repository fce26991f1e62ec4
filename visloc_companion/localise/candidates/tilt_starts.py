"""Several attitudes to start a descent from, where the prior does not know the tilt well enough for one.

Lucas-Kanade finds a tilt that is wrong by some five degrees; beyond, the corners of the picture are more than its basin away.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from visloc_companion.localise.candidates.descent import Descended
from visloc_companion.localise.ortho_rectify import CameraPose
from visloc_companion.localise.pose import heading_and_tilt, turned_about_view
from visloc_companion.types import FloatArray

KNOWN_RAD = math.radians(2.0)
"""A tilt that is known to this (1-sigma) lies within the basin of a descent from the prior's."""
WIDEST_RAD = math.radians(8.0)
"""Largest step between two starts."""


def tilt_is_known(sigma_tilt_rad: float) -> bool:
    """Whether one start and one round do."""
    return sigma_tilt_rad <= KNOWN_RAD


def starts(pose: CameraPose, ground_up_m: float, sigma_tilt_rad: float) -> list[CameraPose]:
    """The pose and, where the tilt is not known well, eight more that look at the same ground, a sigma apart on two axes."""
    if tilt_is_known(sigma_tilt_rad):
        return [pose]
    step = min(sigma_tilt_rad, WIDEST_RAD)
    around = [(a, b) for a in (0, -1, 1) for b in (0, -1, 1)]
    return [turned_about_view(pose, ground_up_m, np.array([a * step, b * step, 0.0])) for a, b in around]


def likeliest(ends: Sequence[Descended], R_prior: FloatArray, sigma_tilt_rad: float, nats_per_score: float) -> Descended:
    """The end of a descent that score and prior tilt together speak for."""

    def nats(end: Descended) -> float:
        _, tilt = heading_and_tilt(end.pose.R_ned_cam, R_prior)
        return nats_per_score * end.score - 0.5 * float(tilt @ tilt) / sigma_tilt_rad**2

    return max(ends, key=nats)
