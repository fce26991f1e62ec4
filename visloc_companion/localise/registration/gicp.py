"""Refinement only: generalised ICP (Segal, Haehnel and Thrun 2009) from the prior, by small_gicp on one thread.

It is rigid: the prior's scale stays.
"""

from __future__ import annotations

import math

import numpy as np
import small_gicp

from visloc_companion.localise.registration.base import NotRegistered, Registered, RegistrationPrior
from visloc_companion.localise.registration.clouds import density_per_m2
from visloc_companion.localise.registration.settle import judged
from visloc_companion.types import FloatArray

REACHES_M = (10.0, 4.0, 2.0)
"""Correspondences up to this far, from coarse to fine."""
LEAST_SPACING_M = 0.5
STEPS = 30


def gicp_from(source_m: FloatArray, reference_m: FloatArray) -> FloatArray:
    """(4, 4) rigid T_reference_source from the prior's (identity), both clouds thinned to the reference's spacing."""
    spacing = max(LEAST_SPACING_M, 1 / math.sqrt(density_per_m2(reference_m)))
    target, tree = small_gicp.preprocess_points(reference_m, downsampling_resolution=spacing, num_threads=1)
    source, _ = small_gicp.preprocess_points(source_m, downsampling_resolution=spacing, num_threads=1)
    T = np.eye(4)
    for reach in REACHES_M:
        found = small_gicp.align(target, source, tree, T, max_correspondence_distance=reach, num_threads=1, max_iterations=STEPS)
        T = np.asarray(found.T_target_source, dtype=np.float64)
    return T


class GicpRegistration:
    """Registration by refinement from the prior: it reaches some 10 m, not 60."""

    def __init__(self, max_probability_wrong: float) -> None:
        self.max_probability_wrong = max_probability_wrong

    def __call__(self, source_m: FloatArray, reference_m: FloatArray, prior: RegistrationPrior) -> Registered | NotRegistered:
        """As base.RegistrationMethod."""
        return judged(gicp_from, (source_m, reference_m), prior, self.max_probability_wrong)
