"""Baseline `mi`: normalised mutual information of grey values over position x heading x scale.

Exhaustive at a coarse level with few bins (joint_histogram.py); the best peaks are climbed at the working resolution with more
bins by a compass search of north, east, heading and height; the highest is the answer, the next distinct one its rival.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from visloc_companion.errors import OutsideMap, Reason
from visloc_companion.localise.answer import Stopwatch, fix, no_fix
from visloc_companion.localise.candidates.claims import with_prior_tilt
from visloc_companion.localise.candidates.hypotheses import (
    footprint_box,
    footprint_heights,
    peaks_in_region,
    pose_of_peak,
    search_box,
)
from visloc_companion.localise.features.grey import GREY
from visloc_companion.localise.frame import FrameLevel, full_level, reduced
from visloc_companion.localise.joint_histogram import Labels, bin_edges, labelled, mutual_information, search_histograms
from visloc_companion.localise.mapped.window import map_grid, searched_map
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid, rectify_surface
from visloc_companion.localise.plan import SearchPlan, planned, turned
from visloc_companion.localise.pose import heading_from
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.localise.verify import log_odds, logistic
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import CameraModel, Fix, FloatArray, Image, LocaliseRequest, NoFix

SEARCH_PIXELS = 64.0
"""Side (px) of the footprint at the exhaustive level, and ..."""
SEARCH_BINS, CLIMB_BINS = 8, 16
"""... bins there and in the climb. On training rows (173 px) the true place is among the three best peaks in 88 % with 8 bins
at 64 or 90 px (which costs four times as much) and in 75 % at 48 px, there with 16 bins in 69 %."""
CLIMB_PIXELS, CLIMB_MARGIN_PX = 128.0, 12
MAX_CANDIDATES = 8
ROUNDS, HALVINGS = 30, 4
WEIGHTS = (-1.99, 8.75, 9.16)
"""Logistic regression of being right on `regressors` (`python -m benchmarks.calibrate_baselines`, training rows only)."""
SIGMA_PX = 1.0
"""Claimed 1-sigma of the position, working pixels: a constant, as the method has no better measure."""
SIGMA_ANGLE_RAD = 0.02
MIN_SCORE = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Climbed:
    """Where the climb from a peak ended and the score there."""

    pose: CameraPose
    score: float
    gsd_m: float


class MutualInformationLocaliser:
    """protocols.Localiser by mutual information of grey values."""

    method = "mi"

    def __init__(self, model: CameraModel, settings: LocaliserSettings) -> None:
        self._model, self._settings = model, settings

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The pose at the highest mutual information, or why there is none."""
        watch = Stopwatch()
        plan = planned(request.prior, pixels, self._model, ref, self._settings, watch)
        if not isinstance(plan, SearchPlan):
            return no_fix(request, self.method, watch, plan)
        full = full_level(pixels, self._model)
        try:
            starts = _candidates(_coarser(plan), full, ref, watch)
            ends = sorted((_climbed(plan, start, full, ref, watch) for start in starts), key=lambda end: -end.score)
        except OutsideMap as outside:
            return no_fix(request, self.method, watch, (Reason.OUTSIDE_MAP, outside.what))
        if not ends or ends[0].score <= 0:
            return no_fix(request, self.method, watch, (Reason.NO_MATCH, "no likeness within the search region"))
        numbers = _evidence(ends, plan)
        p = probability_wrong(regressors(numbers))
        numbers["p_wrong"] = p
        if p > self._settings.max_probability_wrong:
            reason = Reason.AMBIGUOUS if numbers["score"] > MIN_SCORE else Reason.NO_MATCH
            return no_fix(request, self.method, watch, (reason, f"probability of being wrong {p:.3f}"), numbers)
        metres, angles = SIGMA_PX * ends[0].gsd_m, SIGMA_ANGLE_RAD
        own = np.diag(np.array([metres, metres, angles * plan.agl_m, angles, angles, angles]) ** 2)
        covariance = with_prior_tilt(own, request.prior.sigma_tilt_rad, plan.agl_m)
        sigma_m = self._settings.map_sigma_m
        return fix(request, self.method, watch, plan, ref, ends[0].pose, covariance, p, sigma_m, numbers)


def regressors(numbers: dict[str, float]) -> tuple[float, ...]:
    """What the logistic regression is on: constant, score and how far the next place stays behind."""
    return 1.0, numbers["score"], 1 - numbers["runner_up"]


def probability_wrong(values: tuple[float, ...]) -> float:
    """Calibrated probability that the match is another place."""
    return logistic(-log_odds(WEIGHTS, values))


def _coarser(plan: SearchPlan) -> SearchPlan:
    """The plan at the level of the histograms: a coarser resolution needs fewer headings and scales."""
    gsd_m = max(plan.finest_gsd_m, math.sqrt(plan.area_m2) / SEARCH_PIXELS)
    share = plan.coarse_gsd_m / gsd_m
    headings = _thinned(plan.headings_rad, share)
    return replace(plan, coarse_gsd_m=gsd_m, headings_rad=headings, scales=np.exp(_thinned(np.log(plan.scales), share)))


def _thinned(values: FloatArray, share: float) -> FloatArray:
    """A symmetric grid over the same range with about `share` of its values."""
    half = math.ceil(share * (len(values) // 2))
    return np.linspace(values[0], values[-1], 2 * half + 1) if half else values[len(values) // 2 :][:1]


def _candidates(plan: SearchPlan, full: FrameLevel, ref: ReferenceMap, watch: Stopwatch) -> list[CameraPose]:
    """Poses of the best distinct peaks of the exhaustive search."""
    gsd_m = plan.coarse_gsd_m
    with watch:
        low, high = search_box(plan)
        grid = searched_map(ref, plan.frame, low, high, gsd_m, GREY)
    volume = search_histograms(grid, reduced(full, gsd_m / plan.frame_gsd_m), plan, SEARCH_BINS)
    radius_px = max(3.0, 0.06 * math.sqrt(plan.area_m2) / gsd_m)
    peaks = peaks_in_region(volume, grid, plan, MAX_CANDIDATES, radius_px)
    heights = footprint_heights(grid, plan)
    return [pose_of_peak(peak, grid, plan, heights) for peak in peaks]


def _climbed(plan: SearchPlan, start: CameraPose, full: FrameLevel, ref: ReferenceMap, watch: Stopwatch) -> Climbed:
    """Compass search (Hooke & Jeeves 1961) of north, east, heading and logarithm of the height, steps halved at each summit."""
    side_m = math.sqrt(plan.area_m2)
    gsd_m = max(plan.finest_gsd_m, side_m / CLIMB_PIXELS)
    heading = heading_from(start.R_ned_cam, plan.pose.R_ned_cam)
    scale = max(0.1, (-float(start.p_ned_m[2]) - plan.ground_up_m) / plan.agl_m)
    with watch:
        low, high = footprint_box(plan, np.array([heading]), scale)
        around = start.p_ned_m[:2], CLIMB_MARGIN_PX * gsd_m
        grid = map_grid(ref, plan.frame, around[0] + low - around[1], around[0] + high + around[1], gsd_m, GREY)
        there = labelled(grid.features[..., 0], bin_edges(grid.features[..., 0], grid.weight > 0, CLIMB_BINS))
    level = reduced(full, gsd_m / plan.frame_gsd_m)
    edges = bin_edges(level.grey, level.valid > 0, CLIMB_BINS)
    ground_m = -float(start.p_ned_m[2]) - scale * plan.agl_m
    step = np.array([1.0, 1.0, 2 / side_m, 2 / side_m]) * side_m / SEARCH_PIXELS

    def pose(x: FloatArray) -> CameraPose:
        up_m = ground_m + scale * plan.agl_m * math.exp(x[3])
        return CameraPose(np.array([start.p_ned_m[0] + x[0], start.p_ned_m[1] + x[1], -up_m]), turned(start.R_ned_cam, x[2]))

    at, score = np.zeros(4), _likeness(grid, there, level, edges, pose(np.zeros(4)))
    halved = 0
    for _ in range(ROUNDS):
        trials = [at + sign * step * axis for axis in np.eye(4) for sign in (1.0, -1.0)]
        scores = [_likeness(grid, there, level, edges, pose(trial)) for trial in trials]
        best = int(np.argmax(scores))
        if scores[best] > score:
            at, score = trials[best], scores[best]
        elif halved == HALVINGS:
            break
        else:
            step, halved = step / 2, halved + 1
    return Climbed(pose(at), score, gsd_m)


def _likeness(grid: MapGrid, there: Labels, level: FrameLevel, edges: FloatArray, pose: CameraPose) -> float:
    image, seen = rectify_surface(level, pose, grid)
    both = seen & (grid.weight > 0)
    if both.sum() < 0.5 * max(1, int(seen.sum())):
        return 0.0
    return mutual_information(labelled(image, edges), there, both, CLIMB_BINS)


def _evidence(ends: list[Climbed], plan: SearchPlan) -> dict[str, float]:
    best = ends[0]
    apart = [float(np.hypot(*(end.pose.p_ned_m[:2] - best.pose.p_ned_m[:2]))) for end in ends]
    rivals = [end.score for end, m in zip(ends, apart, strict=True) if m > 4 * plan.coarse_gsd_m]
    return {"score": best.score, "runner_up": max(rivals, default=0.0) / best.score, "agl_m": plan.agl_m}
