"""The dense localiser: exhaustive search, Lucas-Kanade, block correspondences, pose with covariance, verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from visloc_companion.errors import OutsideMap, Reason
from visloc_companion.localise.answer import Stopwatch, fix, no_fix
from visloc_companion.localise.claims import claimed_covariance, horizontal_sigma
from visloc_companion.localise.features.base import Features
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.frame import full_level
from visloc_companion.localise.matching import (
    Found,
    Match,
    Task,
    apart_m,
    best_match,
    find_candidates,
    refined_candidates,
    sharpened,
)
from visloc_companion.localise.modes import MODE_RADIUS, mass_near, mode_numbers
from visloc_companion.localise.open_places import open_places, share_of, weighed
from visloc_companion.localise.plan import SearchPlan, planned
from visloc_companion.localise.pose import PoseEstimate, heading_and_tilt
from visloc_companion.localise.ranking import DEEP_RANK, GRADIENT_RANK, RankWeights
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.localise.tilt import beyond, seen_tilt, set_right
from visloc_companion.localise.verify import (
    DEEP_WEIGHTS,
    GRADIENT_WEIGHTS,
    Evidence,
    Weights,
    beside_others,
    block_z,
    crowded,
    probability_wrong,
    refusal,
)
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import CameraModel, Fix, Image, LocaliseRequest, NoFix, PosePrior


@dataclass(frozen=True, slots=True)
class Fitted:
    """What was fitted for a method's features: weights of being right, and of the ranking."""

    right: Weights
    rank: RankWeights
    temperature: float
    """Of the score volume's posterior, times the footprint's side in pixels."""


class DenseLocaliser:
    """protocols.Localiser on dense features. Nothing is kept between frames or random."""

    def __init__(self, method: str, model: CameraModel, settings: LocaliserSettings, features: Features, fitted: Fitted) -> None:
        self.method = method
        self._model, self._settings, self._features, self._fitted = model, settings, features, fitted

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The pose of the camera, or why there is none. Never raises for what an image or a place may contain."""
        answer = self._localised(replace(request, prior=set_right(request.prior)), pixels, ref)
        return answer if isinstance(answer, NoFix) else replace(answer, tilt=beyond(answer.tilt, request.prior.tilt))

    def _localised(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        watch = Stopwatch()
        try:
            plan = planned(request.prior, pixels, self._model, ref, self._settings)
            if not isinstance(plan, SearchPlan):
                return no_fix(request, self.method, watch, plan)
            full = full_level(pixels, self._model)
            rank, temperature = self._fitted.rank, self._fitted.temperature
            features, threads = self._features, self._settings.threads
            task = Task(plan, request.prior, full, ref, watch, features, GRADIENT, rank, temperature, threads=threads)
            found = find_candidates(task)
            matches = refined_candidates(task, found.candidates)
            if not matches:
                return no_fix(request, self.method, watch, (Reason.NO_MATCH, "no likeness within the search region"))
            return self._answer(request, task, found, matches)
        except OutsideMap as outside:
            return no_fix(request, self.method, watch, (Reason.OUTSIDE_MAP, outside.what))

    def _answer(self, request: LocaliseRequest, task: Task, found: Found, matches: list[Match]) -> Fix | NoFix:
        plan = task.plan
        match, lead = best_match(task, matches)
        if match.estimate is None:
            return no_fix(request, self.method, task.watch, (Reason.POSE_FAILED, "the blocks do not determine a pose"))
        others = [c.score for c in found.candidates if apart_m(c.pose, match.descended.pose) > 4 * plan.coarse_gsd_m]
        evidence = _evidence(match, match.estimate, max(others, default=0.0), lead, found, plan, request.prior)
        likely = weighed(task, matches, match, found.modes)
        share = share_of(task, matches, match, likely)
        alone = probability_wrong(evidence, self._fitted.right)
        p = beside_others(alone, share)
        numbers = _numbers(evidence, p, plan.agl_m) | {"share": share} | mode_numbers(found.modes, plan.pose.p_ned_m)
        limit = self._settings.max_probability_wrong
        if why := refusal(evidence, alone, limit) or crowded(p, share, limit):
            declined = no_fix(request, self.method, task.watch, why, numbers)
            places = open_places(task, matches, likely, 1 - alone)
            return replace(declined, open_places=places, footprint_m=math.sqrt(plan.area_m2))
        final = sharpened(task, match)
        estimate = final.estimate or match.estimate
        covariance = claimed_covariance(estimate, final.gsd_m)
        sigma_m = self._settings.map_sigma_m
        pose = estimate.pose
        answer = fix(request, self.method, task.watch, plan.frame, task.ref, pose, covariance, p, sigma_m, numbers)
        north, east = estimate.per_focal[:2].tolist()
        return replace(answer, tilt=seen_tilt(estimate, request.prior), per_focal_ne_m=(north, east))


def gradient_localiser(model: CameraModel, settings: LocaliserSettings) -> DenseLocaliser:
    """Method `gradient`: double-angle gradient orientation throughout."""
    return DenseLocaliser("gradient", model, settings, GRADIENT, Fitted(GRADIENT_WEIGHTS, GRADIENT_RANK, 1.04))


def deep_localiser(model: CameraModel, settings: LocaliserSettings, features: Features) -> DenseLocaliser:
    """Method `deep`: the network's features where candidates are found and judged, gradients where they are sharpened."""
    return DenseLocaliser("deep", model, settings, features, Fitted(DEEP_WEIGHTS, DEEP_RANK, 0.673))


def _evidence(
    best: Match, estimate: PoseEstimate, runner_up: float, lead: float, found: Found, plan: SearchPlan, prior: PosePrior
) -> Evidence:
    pose = estimate.pose
    heading, _ = heading_and_tilt(pose.R_ned_cam, plan.pose.R_ned_cam)
    offset = pose.p_ned_m[:2] - plan.pose.p_ned_m[:2]
    return Evidence(
        score=best.descended.score,
        coarse_score=best.coarse_score,
        runner_up=min(2.0, runner_up / max(best.coarse_score, 1e-6)),
        lead=lead,
        mode_mass=mass_near(found.modes, best.descended.pose.p_ned_m, MODE_RADIUS * math.sqrt(plan.area_m2)),
        blocks=len(best.blocks.agrees),
        agreeing=float(best.blocks.agrees.sum()),
        footprint_px=math.sqrt(plan.area_m2) / plan.fine_gsd_m,
        scatter=estimate.scatter,
        height_sigmas=abs(float(pose.p_ned_m[2] - plan.pose.p_ned_m[2])) / max(prior.sigma_h_m, 1.0),
        yaw_sigmas=abs(heading) / max(prior.sigma_yaw_rad, math.radians(0.5)),
        position_sigmas=math.sqrt(float(offset @ np.linalg.solve(plan.cov_ne_m2, offset))),
        returning=best.returning(),
        sigma_px=horizontal_sigma(claimed_covariance(estimate, best.gsd_m)) / plan.coarse_gsd_m,
    )


def _numbers(evidence: Evidence, p: float, agl_m: float) -> dict[str, float]:
    return evidence.numbers() | {"block_z": block_z(evidence.blocks, evidence.agreeing), "agl_m": agl_m, "p_wrong": p}
