"""Refinement only: generalised ICP (Segal, Haehnel, Thrun 2009) from the prior, by small_gicp on one thread."""

from __future__ import annotations

import numpy as np
import small_gicp

from visloc_companion.errors import Reason
from visloc_companion.localise.registration.base import NotRegistered, Registered, RegistrationPrior
from visloc_companion.localise.registration.clouds import FEWEST_POINTS, checked, density_per_m2, middle_m
from visloc_companion.types import FloatArray

REACHES_M = (10.0, 4.0, 2.0)
"""Correspondences up to this far, from coarse to fine."""


def gicp_from(source_m: FloatArray, reference_m: FloatArray, start: FloatArray) -> FloatArray:
    """(4, 4) rigid T_reference_source from a start, both clouds thinned to the reference's spacing."""
    spacing = max(0.5, 1 / np.sqrt(density_per_m2(reference_m)))
    target, tree = small_gicp.preprocess_points(reference_m, downsampling_resolution=spacing, num_threads=1)
    source, _ = small_gicp.preprocess_points(source_m, downsampling_resolution=spacing, num_threads=1)
    T = start
    for reach in REACHES_M:
        found = small_gicp.align(target, source, tree, T, max_correspondence_distance=reach, num_threads=1, max_iterations=30)
        T = np.asarray(found.T_target_source, dtype=np.float64)
    return T


class GicpRegistration:
    """Registration by refinement from the prior: it reaches some 10 m, not 60."""

    def __init__(self, max_probability_wrong: float) -> None:
        self.max_probability_wrong = max_probability_wrong

    def __call__(self, source_m: FloatArray, reference_m: FloatArray, prior: RegistrationPrior) -> Registered | NotRegistered:
        """As base.RegistrationMethod."""
        source, reference = checked(source_m, "source"), checked(reference_m, "reference")
        if min(len(source), len(reference)) < FEWEST_POINTS:
            return NotRegistered(Reason.TOO_FEW_FEATURES, f"{len(source)} and {len(reference)} points")
        centre = middle_m(source)
        T = gicp_from(source, reference, np.eye(4))
        moved = T[:3, :3] @ centre + T[:3, 3] - centre
        far = float(np.hypot(moved[0], moved[1])) / prior.sigma_horizontal_m
        sigma = np.array([prior.sigma_horizontal_m, prior.sigma_horizontal_m, prior.sigma_vertical_m])
        wrong = 1.0 if far > 3 else 0.5
        if wrong > self.max_probability_wrong:
            return NotRegistered(Reason.NO_MATCH, f"probability of being wrong {wrong:.2f}", (("moved_sigmas", far),))
        return Registered(T, np.diag(sigma**2), prior.sigma_yaw_rad, prior.sigma_scale, wrong, (("moved_sigmas", far),))
