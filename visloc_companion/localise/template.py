"""Baseline `ncc`: normalised cross-correlation of grey values in the same exhaustive search, without learning from edges.

The best peak of the search level is searched again at the working resolution; its parabola is the answer.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from visloc_companion.errors import OutsideMap, Reason
from visloc_companion.localise.answer import Stopwatch, fix, no_fix
from visloc_companion.localise.candidates.claims import with_prior_tilt
from visloc_companion.localise.candidates.frame_features import ForEachPose
from visloc_companion.localise.candidates.hypotheses import (
    footprint_heights,
    peaks_in_region,
    pose_of_peak,
    search_box,
    search_window,
)
from visloc_companion.localise.features.grey import GREY
from visloc_companion.localise.frame import FrameLevel, full_level, reduced
from visloc_companion.localise.mapped.surface_error import unresolved_m
from visloc_companion.localise.mapped.window import part_of_box, searched_map
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid
from visloc_companion.localise.plan import SearchPlan, planned, view_box
from visloc_companion.localise.pose import heading_from
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.localise.verify import logistic
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import CameraModel, Fix, Image, LocaliseRequest, NoFix

SIGMA_PX = 1.5
"""Claimed 1-sigma of the position, working pixels: a constant, as the method has no better measure."""
SIGMA_ANGLE_RAD = 0.02
RELIEF_SHARE = 0.5
"""Of the standard deviation of the surface in view, which is searched as a plane: added to the claimed 1-sigma of the height. Set
on made land (three seeds, 2 to 20 m)."""


class NccLocaliser:
    """protocols.Localiser by template matching of grey values."""

    method = "ncc"

    def __init__(self, model: CameraModel, settings: LocaliserSettings) -> None:
        self._model, self._settings = model, settings

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The pose at the highest correlation, or why there is none."""
        watch = Stopwatch()
        plan = planned(request.prior, pixels, self._model, ref, self._settings, watch)
        if not isinstance(plan, SearchPlan):
            return no_fix(request, self.method, watch, plan)
        full = full_level(pixels, self._model)
        try:
            poses, scores, _ = _best(plan, plan.coarse_gsd_m, full, ref, watch)
            if not poses:
                return no_fix(request, self.method, watch, (Reason.NO_MATCH, "no likeness within the search region"))
            narrow = _narrowed(plan, poses[0])
            fine, fine_scores, grid = _best(narrow, narrow.fine_gsd_m, full, ref, watch)
        except OutsideMap as outside:
            return no_fix(request, self.method, watch, (Reason.OUTSIDE_MAP, outside.what))
        runner_up = scores[1] / scores[0] if len(scores) > 1 else 0.0
        p = _probability_wrong(scores[0], runner_up)
        numbers = {"score": scores[0], "runner_up": runner_up, "p_wrong": p}
        if p > self._settings.max_probability_wrong or not fine:
            reason = Reason.AMBIGUOUS if scores[0] > 0.3 else Reason.NO_MATCH
            return no_fix(request, self.method, watch, (reason, f"probability of being wrong {p:.3f}"), numbers)
        numbers["fine_score"] = fine_scores[0]
        sigma = (
            np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]) * SIGMA_PX * plan.fine_gsd_m + np.array([0, 0, 0, 1, 1, 1]) * SIGMA_ANGLE_RAD
        )
        seen = part_of_box(grid, *view_box(plan, fine[0]), 0)
        sigma[2] = math.hypot(sigma[2], RELIEF_SHARE * float(seen.surface_up_m.std()), unresolved_m(seen))
        covariance = with_prior_tilt(np.diag(sigma**2), request.prior.sigma_tilt_rad, plan.agl_m)
        return fix(request, self.method, watch, plan, ref, fine[0], covariance, p, self._settings.map_sigma_m, numbers)


def _best(
    plan: SearchPlan, gsd_m: float, full: FrameLevel, ref: ReferenceMap, watch: Stopwatch
) -> tuple[list[CameraPose], list[float], MapGrid]:
    """The two best distinct peaks of an exhaustive search at a level, as poses with scores, and the map that was searched."""
    with watch:
        low, high = search_box(plan)
        grid = searched_map(ref, plan.frame, low, high, gsd_m, GREY)
    frame = ForEachPose(reduced(full, grid.gsd_m / plan.frame_gsd_m), GREY)
    volume = search_window(grid, frame, plan, zero_mean=True)
    peaks = peaks_in_region(volume, grid, plan, 2, max(3.0, 0.06 * math.sqrt(plan.area_m2) / gsd_m))
    heights = footprint_heights(grid, plan)
    return [pose_of_peak(peak, grid, plan, heights) for peak in peaks], [peak.score for peak in peaks], grid


def _narrowed(plan: SearchPlan, pose: CameraPose) -> SearchPlan:
    """The plan of the second search: two coarse pixels, half a step of heading and scale about a pose."""
    heading = heading_from(pose.R_ned_cam, plan.pose.R_ned_cam)
    step = 3.2 * plan.coarse_gsd_m / (0.4 * math.sqrt(plan.area_m2))
    scale = (-float(pose.p_ned_m[2]) - plan.ground_up_m) / plan.agl_m
    offsets = np.linspace(-0.5, 0.5, 5) * step
    at = CameraPose(np.array([pose.p_ned_m[0], pose.p_ned_m[1], plan.pose.p_ned_m[2]]), plan.pose.R_ned_cam)
    reach = (2 * plan.coarse_gsd_m / 3 + plan.fine_gsd_m) ** 2
    return replace(plan, pose=at, headings_rad=heading + offsets, scales=scale * np.exp(offsets), cov_ne_m2=np.eye(2) * reach)


def _probability_wrong(score: float, runner_up: float) -> float:
    """Logistic in the score and the runner-up ratio, fitted on training rows (benchmarks/calibrate.py)."""
    return logistic(-(-4.62 + 4.02 * score + 12.8 * (1 - runner_up)))
