"""How sure a fitted lens is: what its numbers do when a view is left out.

Corners of one view err together (a bent sheet, blur, a shutter that rolls), so that the covariance of independent residuals
promises too much. The jackknife over views (Tukey 1958; here in one linear step each, as Cook's distance) does not, and holds for
every model.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from visloc_companion.prepare.lens.fit import free_numbers
from visloc_companion.prepare.lens.view import Lens, View, beside_poses
from visloc_companion.types import FloatArray

_LEAST_SCALE = 1e-12


def covariance(lens: Lens, views: Sequence[View]) -> FloatArray:
    """(4 + K, 4 + K) of fx, fy, cx, cy (px) and the coefficients; zero of one that was not fitted, infinite where the views
    without one of them leave it open."""
    told, pulls = beside_poses(lens, views)
    free = free_numbers(lens.model)
    size, n = pulls[0].size, len(views)
    told, pulls = [a[np.ix_(free, free)] for a in told], [g[free] for g in pulls]
    whole = np.sum(told, axis=0)
    scale = 1 / np.sqrt(np.maximum(np.diag(whole), _LEAST_SCALE))
    outer = np.outer(scale, scale)
    try:
        steps = np.array([scale * np.linalg.solve((whole - a) * outer, g * scale) for a, g in zip(told, pulls, strict=True)])
    except np.linalg.LinAlgError:
        return np.full((size, size), np.inf)
    found = np.zeros((size, size))
    found[np.ix_(free, free)] = (n - 1) / n * steps.T @ steps
    return found if np.isfinite(found).all() else np.full((size, size), np.inf)
