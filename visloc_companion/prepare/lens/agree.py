"""Whether the views agree on one lens: a zoom or focus that moved, a picture that was stabilised, cropped, turned round or by
another camera, and a shutter that rolled over a moving board fit well each by itself, for another pose takes up most of it.

Each view is asked for a focal length and a principal point of its own, and by how much these scatter is held against what its
corners err by. Residuals say less: pictures that were zoomed by 0 to 3 % lay 0.16 px off, as good ones do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from visloc_companion.prepare.lens.view import Lens, View, all_residuals_px, beside_poses

SURE = 3.5
"""Mean of chi-squared of one number of each view. Of independent errors it is 1; blur, compression and a model that fits nearly
made up to 2.5 of it in good pictures (11 sets), and views that are not of one lens at least 5.5 of one of the three (5 sets)."""


@dataclass(frozen=True, slots=True)
class Scatter:
    """1-sigma between the views, beyond what their corners err by: of the focal length, as a share of it, and of the principal
    point, px (the larger of both axes'); 0 where they agree."""

    focal_share: float
    centre_px: float


def scatter(lens: Lens, views: Sequence[View]) -> Scatter:
    """By how much the views' own focal lengths and principal points differ, the rest of the lens being as it is."""
    told, pulls = beside_poses(lens, views)
    own = [np.zeros(len(pulls[0])) for _ in range(3)]
    own[0][:2] = lens.model.fx_px, lens.model.fy_px
    own[1][2] = own[2][3] = 1.0
    squares = [float(np.square(off).sum()) for off in all_residuals_px(lens, views)]
    found = []
    for way in own:
        known = np.array([way @ one @ way for one in told])
        pull = np.array([way @ one for one in pulls])
        freedom = np.array([2 * len(view.ids) - 7 for view in views])
        noise = (np.array(squares) - pull**2 / known) / freedom
        found.append(_beyond(pull / known, noise / known))
    return Scatter(found[0], max(found[1:]))


def _beyond(steps: np.ndarray, variances: np.ndarray) -> float:
    """1-sigma of (V,) steps beyond their own variances; 0 where these explain them."""
    if float(np.mean(steps**2 / variances)) <= SURE:
        return 0.0
    weights = 1 / variances
    return math.sqrt(max(0.0, float(np.sum(weights * (steps**2 - variances)) / weights.sum())))
