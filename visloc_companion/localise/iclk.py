"""Baseline `iclk`: deep features and inverse-compositional Lucas-Kanade alone, from the prior, without any search.

After Sabel, Maki, Westin & Åsvärn 2022 and Goforth & Lucey 2019. The map is the template (align.py precomputes its gradients);
instead of eight free numbers of a homography the camera's pose is solved for, which over level ground is the homography of a
calibrated camera and over a surface model more than that. Over a coarse surface model the heights between its samples are solved
for as well (open_ground.py). Where the prior is too far off, this localiser cannot start: it declines.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from visloc_companion.errors import OutsideMap, Reason
from visloc_companion.localise import align
from visloc_companion.localise.answer import Stopwatch, fix, no_fix
from visloc_companion.localise.candidates.clustered import excess_variance
from visloc_companion.localise.candidates.descent import Descended, descend, descend_open
from visloc_companion.localise.candidates.pyramid import LEVELS, LowPassed, View, blurred, view, window
from visloc_companion.localise.features.base import Features
from visloc_companion.localise.mapped.open_ground import open_ground
from visloc_companion.localise.mapped.surface_error import is_coarse
from visloc_companion.localise.ortho_rectify import CameraPose
from visloc_companion.localise.plan import SearchPlan, planned
from visloc_companion.localise.pose import heading_from
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.localise.verify import log_odds, logistic
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import CameraModel, Fix, FloatArray, Image, LocaliseRequest, NoFix, PosePrior

WEIGHTS = (-19.0, 42.0, 7.74, -3.4)
"""Logistic regression of being right on `regressors` (`python -m benchmarks.calibrate_baselines --n 100`, training rows only)."""
COVARIANCE_FACTOR = 1.3
"""Factor on the alignment's formal sigmas, and ..."""
SIGMA_FLOOR_PX = 0.3
"""... what is added to the horizontal sigma (working pixels). Both fitted on training rows."""
MIN_SCORE = 0.12


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Where the descent through all levels ended, how far (working px) the last pass still moved it, the last GSD, and by
    how much more pulls at the pose there than its information says (6, 6; clustered.py)."""

    end: Descended
    settled_px: float
    gsd_m: float
    excess: FloatArray


class IclkLocaliser:
    """protocols.Localiser by Lucas-Kanade from the prior. Nothing is kept between frames or random."""

    method = "iclk"

    def __init__(self, model: CameraModel, settings: LocaliserSettings, features: Features) -> None:
        self._model, self._settings, self._features = model, settings, features

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The pose where the descent from the prior ended, or why it is not believed."""
        watch = Stopwatch()
        plan = planned(request.prior, pixels, self._model, ref, self._settings, watch)
        if not isinstance(plan, SearchPlan):
            return no_fix(request, self.method, watch, plan)
        try:
            found = aligned(view(pixels, self._model, plan, request.prior, plan.frame), ref, self._features, watch)
        except OutsideMap as outside:
            return no_fix(request, self.method, watch, (Reason.OUTSIDE_MAP, outside.what))
        if found is None:
            return no_fix(request, self.method, watch, (Reason.LOW_OVERLAP, "frame and map do not overlap at the prior"))
        numbers = evidence(found, plan, request.prior)
        p = probability_wrong(regressors(numbers))
        numbers["p_wrong"] = p
        covariance = claimed_covariance(found)
        if p > self._settings.max_probability_wrong or covariance is None:
            reason = Reason.NO_MATCH if numbers["score"] < MIN_SCORE else Reason.REFINEMENT_DIVERGED
            return no_fix(request, self.method, watch, (reason, f"probability of being wrong {p:.3f}"), numbers)
        sigma_m = self._settings.map_sigma_m
        return fix(request, self.method, watch, plan, ref, found.end.pose, covariance, p, sigma_m, numbers)


def aligned(start: View, ref: ReferenceMap, features: Features, watch: Stopwatch) -> Alignment | None:
    """Lucas-Kanade through the levels; None where frame and map do not overlap. Raises OutsideMap."""
    pose = start.start
    for level in LEVELS:
        with watch:
            grid = window(start, pose, level, ref, start.plan.frame, features)
        frame = start.on(grid, features)
        ground = open_ground(grid) if is_coarse(grid) else None
        for sigma_px, steps in level.passes:
            with watch:
                smooth = blurred(grid, sigma_px)
                descent = align.prepare(smooth)
            low = LowPassed(frame, sigma_px)
            if ground is None:
                end = descend(low, pose, smooth, descent, start.prior, steps)
            else:
                end, ground = descend_open(low, pose, smooth, descent, start.prior, steps, ground)
            if end.score <= -1:
                return None
            moved_px = float(np.abs(end.pose.p_ned_m - pose.p_ned_m).max()) / grid.gsd_m
            pose = end.pose
    excess = excess_variance(low, pose, smooth, descent, start.prior, ground)
    return Alignment(end, moved_px, grid.gsd_m, excess)


def evidence(found: Alignment, plan: SearchPlan, prior: PosePrior) -> dict[str, float]:
    """What is known of an alignment: correlation, convergence, and distances from the prior in sigmas."""
    pose: CameraPose = found.end.pose
    heading = heading_from(pose.R_ned_cam, plan.pose.R_ned_cam)
    offset = pose.p_ned_m[:2] - plan.pose.p_ned_m[:2]
    return {
        "score": found.end.score,
        "settled_px": found.settled_px,
        "footprint_px": math.sqrt(plan.area_m2) / found.gsd_m,
        "height_sigmas": abs(float(pose.p_ned_m[2] - plan.pose.p_ned_m[2])) / max(prior.sigma_h_m, 1.0),
        "yaw_sigmas": abs(heading) / max(prior.sigma_yaw_rad, math.radians(0.5)),
        "position_sigmas": math.sqrt(float(offset @ np.linalg.solve(plan.cov_ne_m2, offset))),
        "agl_m": plan.agl_m,
    }


def regressors(numbers: dict[str, float]) -> tuple[float, ...]:
    """What the logistic regression is on, from `evidence`: a uniform prior of this sigma ends at 1.7 in each of its axes.

    How far the last pass moved the pose adds nothing once the score is known (training rows).
    """
    beyond = sum(max(0.0, min(numbers[k], 5.0) - 2) for k in ("position_sigmas", "yaw_sigmas", "height_sigmas"))
    size = math.log(numbers["footprint_px"] / 173)
    return 1.0, numbers["score"], numbers["score"] * size, beyond


def probability_wrong(values: tuple[float, ...]) -> float:
    """Calibrated probability that the descent ended at another place."""
    return logistic(-log_odds(WEIGHTS, values))


def claimed_covariance(found: Alignment) -> FloatArray | None:
    """(6, 6) of north, east, up and rotation: the alignment's, wider where parts of the frame pull it to and fro, scaled and with
    a floor; None where it is undetermined."""
    information = found.end.information
    if not np.all(np.diag(information) > 0) or np.linalg.cond(information) > 1e14:
        return None
    formal = np.linalg.inv(information)
    covariance = (formal + formal @ found.excess @ formal) * COVARIANCE_FACTOR**2
    covariance[:2, :2] += np.eye(2) * (SIGMA_FLOOR_PX * found.gsd_m) ** 2
    return np.asarray(covariance, dtype=np.float64)
