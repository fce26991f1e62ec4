"""Whether a lens is out of centre where its model cannot say so.

Of `fisheye` there is no tangential term, as the other two have it (p1, p2): what a lens out of centre adds is taken for another
principal point, and its residuals hardly tell. So that term is let free beside the lens for one step of the fit, and by how much
the lens's numbers move then is what they may be wrong by.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from visloc_companion.geo.camera import project
from visloc_companion.prepare.lens.view import Lens, View, beside_poses
from visloc_companion.types import CameraModel, FloatArray

DOUBT = 0.001
"""Of so many lenses in centre one is taken for one that is not."""
_TERMS = 2


@dataclass(frozen=True, slots=True, eq=False)
class OffCentre:
    """`step`: (4 + K,) by how much fx, fy, cx, cy (px) and the coefficients move where the lens may be out of centre; `sure`:
    whether the views tell that it is."""

    step: FloatArray
    sure: bool


IN_CENTRE = OffCentre(np.zeros(0), False)
"""Of a model that was not fitted."""


def off_centre(lens: Lens, views: Sequence[View]) -> OffCentre:
    """As far as the views tell; no step for a model that has the term itself."""
    nothing = OffCentre(np.zeros(4 + len(lens.model.distortion)), False)
    if lens.model.distortion_model != "fisheye":
        return nothing
    told, pulls = beside_poses(lens, views, lambda pose, view: _by_terms(lens.model, pose, view))
    whole, pull, n = np.sum(told, axis=0), np.sum(pulls, axis=0), len(views)
    try:
        step = np.linalg.solve(whole, pull)
        apart = np.array([np.linalg.solve(whole - a, pull - g) - step for a, g in zip(told, pulls, strict=True)])[:, -_TERMS:]
        chi2 = float(step[-_TERMS:] @ np.linalg.solve((n - 1) / n * apart.T @ apart, step[-_TERMS:]))
    except np.linalg.LinAlgError:
        return nothing
    return OffCentre(step[:-_TERMS], chi2 > _limit(n)) if np.isfinite(step).all() else nothing


def _limit(n: int) -> float:
    """What Hotelling's T² of two numbers exceeds once in 1 / DOUBT times, their covariance being told by n views (1931)."""
    free = n - _TERMS
    return float(_TERMS * (n - 1) / free * (free / 2) * (DOUBT ** (-2 / free) - 1))


def _by_terms(model: CameraModel, pose: FloatArray, view: View) -> FloatArray:
    """(2N, 2) derivatives of where corners are shown by p1 and p2, of what the fisheye model makes of rays."""
    turn, _ = cv2.Rodrigues(pose[:3])
    focal = np.array([model.fx_px, model.fy_px])
    x, y = ((project(model, view.board_m @ turn.T + pose[3:]) - (model.cx_px, model.cy_px)) / focal).T
    r2, xy = x * x + y * y, 2 * x * y
    by_p1, by_p2 = np.column_stack([xy, r2 + 2 * y * y]) * focal, np.column_stack([r2 + 2 * x * x, xy]) * focal
    return np.asarray(np.stack([by_p1.ravel(), by_p2.ravel()], axis=1), dtype=np.float64)
