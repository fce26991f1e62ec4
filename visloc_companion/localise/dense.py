"""The dense localiser: exhaustive search, Lucas-Kanade, block correspondences, pose with covariance, verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from visloc_companion.errors import OutsideMap, Reason
from visloc_companion.localise import align
from visloc_companion.localise.answer import Stopwatch, fix, no_fix
from visloc_companion.localise.blocks import BlockMatches, correspondences, match_blocks
from visloc_companion.localise.descent import Descended, descend, rectified
from visloc_companion.localise.features.gradient import gradient_features
from visloc_companion.localise.frame import FrameLevel, check_pixels, full_level, reduced
from visloc_companion.localise.hypotheses import (
    footprint_box,
    footprint_heights,
    peaks_in_region,
    pose_of_peak,
    search_box,
    search_window,
)
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid
from visloc_companion.localise.plan import SearchPlan, make_plan
from visloc_companion.localise.pose import PoseEstimate, PriorTerm, heading_and_tilt, solve_pose
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.localise.verify import Evidence, probability_wrong, refusal
from visloc_companion.localise.window import cropped, map_grid
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import CameraModel, Fix, FloatArray, Image, LocaliseRequest, NoFix, PosePrior

COARSE_STEPS, FINE_STEPS = 5, 4
MAX_CANDIDATES, MAX_FINE = 10, 3
PEAK_SHARE, FINE_SHARE = 0.55, 0.75
FINE_MARGIN_PX = 8
COVARIANCE_FACTOR = 1.7
"""Factor on the pose's formal sigmas, and ..."""
SIGMA_FLOOR_PX = 0.2
"""... what is added to the horizontal sigma (working pixels): errors common to all blocks. Both fitted on training rows."""


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """A candidate refined at the fine level, with its independent check."""

    descended: Descended
    coarse_score: float
    blocks: BlockMatches
    estimate: PoseEstimate | None

    @property
    def strength(self) -> float:
        """What candidates are ranked by: correlation, and the share of blocks that agree."""
        share = float(self.blocks.agrees.mean()) if len(self.blocks.agrees) else 0.0
        return self.descended.score + 0.5 * share


class GradientLocaliser:
    """protocols.Localiser on double-angle gradient orientation features. Deterministic; keeps nothing between frames."""

    method = "gradient"

    def __init__(self, model: CameraModel, settings: LocaliserSettings) -> None:
        self._model, self._settings = model, settings

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The pose of the camera, or why there is none. Never raises for what an image or a place may contain."""
        watch = Stopwatch()
        if why := check_pixels(pixels, self._model):
            return no_fix(request, self.method, watch, why)
        plan = make_plan(request.prior, self._model, ref, self._settings)
        if not isinstance(plan, SearchPlan):
            return no_fix(request, self.method, watch, plan)
        full = full_level(pixels, self._model)
        try:
            candidates = self._candidates(plan, request.prior, full, ref, watch)
            matches = self._matches(candidates, plan, request.prior, full, ref, watch)
        except OutsideMap as why_outside:
            return no_fix(request, self.method, watch, (Reason.OUTSIDE_MAP, why_outside.what))
        if not matches:
            return no_fix(request, self.method, watch, (Reason.NO_MATCH, "no likeness within the search region"))
        return self._answer(request, plan, candidates, matches, ref, watch)

    def _candidates(
        self, plan: SearchPlan, prior: PosePrior, full: FrameLevel, ref: ReferenceMap, watch: Stopwatch
    ) -> list[Descended]:
        """Peaks of the exhaustive search, each refined at the search level, best first."""
        with watch:
            low, high = search_box(plan)
            grid = cropped(map_grid(ref, plan.frame, low, high, plan.coarse_gsd_m, self.method, gradient_features))
            descent = align.prepare(grid)
        level = reduced(full, plan.coarse_gsd_m / plan.frame_gsd_m)
        volume = search_window(grid, level, plan, gradient_features)
        radius_px = max(3.0, 0.06 * math.sqrt(plan.area_m2) / grid.gsd_m)
        peaks = peaks_in_region(volume, grid, plan, MAX_CANDIDATES, radius_px)
        heights = footprint_heights(grid, plan)
        term = _whole_prior(plan, prior)
        found = []
        for peak in peaks:
            if peak.score < PEAK_SHARE * peaks[0].score:
                break
            start = pose_of_peak(peak, grid, plan, heights)
            part, part_descent = _around(grid, descent, plan, start)
            found.append(descend(level, start, part, part_descent, term, gradient_features, COARSE_STEPS))
        return sorted(found, key=lambda c: -c.score)

    def _matches(
        self,
        candidates: list[Descended],
        plan: SearchPlan,
        prior: PosePrior,
        full: FrameLevel,
        ref: ReferenceMap,
        watch: Stopwatch,
    ) -> list[Match]:
        """The best candidates refined and checked at the fine level, strongest first."""
        level = reduced(full, plan.fine_gsd_m / plan.frame_gsd_m)
        term, tilt_only = _whole_prior(plan, prior), PriorTerm(plan.pose.R_ned_cam, prior.sigma_tilt_rad)
        matches: list[Match] = []
        for candidate in distinct(candidates, 2 * plan.coarse_gsd_m)[:MAX_FINE]:
            if candidate.score < max(0.05, FINE_SHARE * candidates[0].score):
                break
            with watch:
                low, high = _footprint_at(plan, candidate.pose)
                margin = FINE_MARGIN_PX * plan.fine_gsd_m
                grid = map_grid(ref, plan.frame, low - margin, high + margin, plan.fine_gsd_m, self.method, gradient_features)
                descent = align.prepare(grid)
            fine = descend(level, candidate.pose, grid, descent, term, gradient_features, FINE_STEPS)
            if fine.score <= 0:
                continue
            seen = rectified(level, fine.pose, grid, gradient_features)
            blocks = match_blocks(grid, seen.features, seen.weight)
            ground, pix, sigma_px = correspondences(blocks, grid, level.K, fine.pose)
            estimate = solve_pose(ground, pix, sigma_px, level.K, fine.pose, tilt_only)
            matches.append(Match(fine, candidate.score, blocks, estimate))
        return sorted(matches, key=lambda m: -m.strength)

    def _answer(
        self,
        request: LocaliseRequest,
        plan: SearchPlan,
        candidates: list[Descended],
        matches: list[Match],
        ref: ReferenceMap,
        watch: Stopwatch,
    ) -> Fix | NoFix:
        best = matches[0]
        others = [c.score for c in candidates if _apart_m(c.pose, best.descended.pose) > 4 * plan.coarse_gsd_m]
        if best.estimate is None:
            return no_fix(request, self.method, watch, (Reason.POSE_FAILED, "the blocks do not determine a pose"))
        evidence = _evidence(best, max(others, default=0.0), plan, request.prior)
        p = probability_wrong(evidence)
        numbers = _numbers(evidence, best, p, plan.agl_m)
        if why := refusal(evidence, self._settings.max_probability_wrong):
            return no_fix(request, self.method, watch, why, numbers)
        covariance = best.estimate.covariance * COVARIANCE_FACTOR**2
        covariance[:2, :2] += np.eye(2) * (SIGMA_FLOOR_PX * plan.fine_gsd_m) ** 2
        pose = best.estimate.pose
        return fix(request, self.method, watch, plan.frame, ref, pose, covariance, p, self._settings.map_sigma_m, numbers)


def distinct(candidates: list[Descended], radius_m: float) -> list[Descended]:
    """The candidates without those that ended within a radius of a better one."""
    kept: list[Descended] = []
    for candidate in candidates:
        if all(_apart_m(candidate.pose, other.pose) > radius_m for other in kept):
            kept.append(candidate)
    return kept


def _apart_m(a: CameraPose, b: CameraPose) -> float:
    return float(np.hypot(*(a.p_ned_m[:2] - b.p_ned_m[:2])))


def _whole_prior(plan: SearchPlan, prior: PosePrior) -> PriorTerm:
    return PriorTerm(
        plan.pose.R_ned_cam, prior.sigma_tilt_rad, prior.sigma_yaw_rad, -float(plan.pose.p_ned_m[2]), prior.sigma_h_m
    )


def _footprint_at(plan: SearchPlan, pose: CameraPose) -> tuple[FloatArray, FloatArray]:
    """Box (low, high) metres north, east of what a pose sees."""
    heading, _ = heading_and_tilt(pose.R_ned_cam, plan.pose.R_ned_cam)
    scale = max(0.1, (-float(pose.p_ned_m[2]) - plan.ground_up_m) / plan.agl_m)
    low, high = footprint_box(plan, np.array([heading]), scale)
    return pose.p_ned_m[:2] + low, pose.p_ned_m[:2] + high


def _around(grid: MapGrid, descent: align.Descent, plan: SearchPlan, pose: CameraPose) -> tuple[MapGrid, align.Descent]:
    """The part of a window that a pose sees, with a margin."""
    low, high = _footprint_at(plan, pose)
    corners = np.array([[a, b] for a in (low[0], high[0]) for b in (low[1], high[1])]) - grid.A_ne_pix[:, 2]
    pix = corners @ np.linalg.inv(grid.A_ne_pix[:, :2]).T
    height, width = grid.weight.shape
    u0, v0 = (int(max(0, x)) for x in np.floor(pix.min(0)) - FINE_MARGIN_PX)
    u1, v1 = (int(x) for x in np.ceil(pix.max(0)) + FINE_MARGIN_PX)
    u0, v0 = min(u0, width - 8), min(v0, height - 8)
    rows, cols = slice(v0, max(v1, v0 + 8)), slice(u0, max(u1, u0 + 8))
    A = grid.A_ne_pix.copy()
    A[:, 2] += A[:, :2] @ np.array([u0, v0], dtype=np.float64)
    part = MapGrid(grid.features[rows, cols], grid.weight[rows, cols], grid.surface_up_m[rows, cols], A, grid.gsd_m)
    return part, align.Descent(descent.template[rows, cols], descent.d_north[rows, cols], descent.d_east[rows, cols])


def _evidence(best: Match, runner_up: float, plan: SearchPlan, prior: PosePrior) -> Evidence:
    pose = best.estimate.pose if best.estimate else best.descended.pose
    heading, _ = heading_and_tilt(pose.R_ned_cam, plan.pose.R_ned_cam)
    offset = pose.p_ned_m[:2] - plan.pose.p_ned_m[:2]
    return Evidence(
        score=best.descended.score,
        runner_up=min(2.0, runner_up / max(best.coarse_score, 1e-6)),
        blocks=len(best.blocks.agrees),
        agreeing=float(best.blocks.agrees.sum()),
        height_sigmas=abs(float(pose.p_ned_m[2] - plan.pose.p_ned_m[2])) / max(prior.sigma_h_m, 1.0),
        yaw_sigmas=abs(heading) / max(prior.sigma_yaw_rad, math.radians(0.5)),
        position_sigmas=math.sqrt(float(offset @ np.linalg.solve(plan.cov_ne_m2, offset))),
    )


def _numbers(evidence: Evidence, best: Match, p: float, agl_m: float) -> dict[str, float]:
    return {
        "score": evidence.score,
        "coarse_score": best.coarse_score,
        "runner_up": evidence.runner_up,
        "blocks": evidence.blocks,
        "blocks_agreeing": evidence.agreeing,
        "block_z": evidence.block_z(),
        "scatter_px": best.estimate.scatter if best.estimate else 0.0,
        "height_sigmas": evidence.height_sigmas,
        "yaw_sigmas": evidence.yaw_sigmas,
        "position_sigmas": evidence.position_sigmas,
        "agl_m": agl_m,
        "p_wrong": p,
    }
