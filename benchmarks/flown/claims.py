"""What accepted fixes of flights without pictures claim: to be wrong with a probability whose logarithm is uniform."""

from __future__ import annotations

import numpy as np

CLAIMS = (1e-4, 0.05)
"""Least and greatest claim of an accepted fix."""


def claimed(rng: np.random.Generator) -> float:
    """The probability of being wrong that a fix claims."""
    return float(np.exp(rng.uniform(*np.log(CLAIMS))))
