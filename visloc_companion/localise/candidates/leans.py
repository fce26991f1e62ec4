"""Attitudes that a prior of unknown lean allows, a step apart, and what the search of one of them leaves to be refined.

A frame whose heading is not known is searched under all of them (plan.py). Its lean is two more unknowns, of which a template
bears some eight degrees: on training frames of 144 px the right place scores 0.58 with the lean as it was, 0.56 with 8 degrees
off and 0.53 with 12, where a heading 8 degrees off leaves 0.52 (network's features at 45 px a footprint).
"""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.geo.se3 import R_from_quat, quat_from_vector, quat_multiply
from visloc_companion.types import PosePrior, Quat

STEP_RAD = math.radians(14.0)
"""Between two leans."""
MOST_RAD = math.radians(50.0)
"""Of what a camera that looks down leans; beyond it half of what it sees is too flat to be matched."""
SIGMAS = 3.0
LEAST_IN_A_RING = 5


def leans(prior: PosePrior) -> list[Quat]:
    """Attitudes within three sigmas of the prior's tilt, its own first, at most STEP_RAD apart; one where it is known.

    Those that lean by more than MOST_RAD are left out, but the prior's own.
    """
    reach = SIGMAS * prior.sigma_tilt_rad
    found = [prior.q_ned_frd]
    rings = math.ceil((reach - STEP_RAD / 2) / STEP_RAD) if reach > STEP_RAD / 2 else 0
    for ring in range(1, rings + 1):
        lean = ring * STEP_RAD
        if lean - STEP_RAD / 2 > 2 * MOST_RAD:
            break
        count = max(LEAST_IN_A_RING, round(2 * math.pi * math.sin(min(lean, math.pi / 2)) / STEP_RAD))
        around = 2 * math.pi * (np.arange(count) + 0.5 * (ring % 2)) / count
        turns = [(lean * math.cos(a), lean * math.sin(a), 0.0) for a in around.tolist()]
        found += [quat_multiply(prior.q_ned_frd, quat_from_vector(turn)) for turn in turns]
    least = math.cos(MOST_RAD)
    return [q for k, q in enumerate(found) if k == 0 or float(R_from_quat(q)[2, 2]) >= least]
