"""Exhaustive search of a frame whose lean is not known: heading x scale x place under each of a lattice of leans.

The scores of two leans do not compare: one that sees far has more of the ground under its template, and less by chance. What a
peak stands out by among all places under the same lean does (standard deviations of the score there).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from visloc_companion.localise.answer import Stopwatch
from visloc_companion.localise.candidates.frame_features import Resampled
from visloc_companion.localise.candidates.hypotheses import footprint_heights, pose_of_peak, region, search_box, search_window
from visloc_companion.localise.features.base import Features
from visloc_companion.localise.frame import FrameLevel, reduced
from visloc_companion.localise.mapped.window import cropped, map_grid, part_of_box
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid
from visloc_companion.localise.plan import SearchPlan, grid_step, with_steps
from visloc_companion.localise.pose import to_view
from visloc_companion.localise.search import NO_SCORE, find_peaks
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import FloatArray

SIDE_PX = 45.0
"""Side of the smallest footprint at this search."""
STEP_PX = 2.2
"""As plan.STEP_PX, for templates that need only point to a place."""
PASS_SERVES = (math.radians(8.0), 0.25)
"""Turn and change of scale within which one pass of the network serves: it sees few pixels, and a place is all that is wanted."""
PEAKS_EACH = 6
APART = 0.1
"""Of the footprint's side: peaks of one lean, and candidates that are told apart."""
APART_COS = math.cos(math.radians(20.0))
MARGIN_PX = 8


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A pose of the search: metres and attitude in the plan's local frame, how far it stands out, the footprint's side (m)."""

    pose: CameraPose
    stands_out: float
    agl_m: float
    side_m: float
    view_ne_m: FloatArray


def searched_leans(
    plans: Sequence[SearchPlan], full: FrameLevel, ref: ReferenceMap, features: Features, watch: Stopwatch, threads: int
) -> list[Candidate]:
    """The best peaks of all plans, which share a local frame, those first that stand out most. Raises OutsideMap."""
    gsd_m = min(math.sqrt(plan.area_m2) for plan in plans) / SIDE_PX
    step = grid_step(STEP_PX, SIDE_PX)
    coarse = [with_steps(plan, max(gsd_m, plan.finest_gsd_m), step) for plan in plans]
    boxes = [search_box(plan) for plan in coarse]
    low = reduce(np.minimum, [box[0] for box in boxes])
    high = reduce(np.maximum, [box[1] for box in boxes])
    with watch:
        whole = map_grid(ref, plans[0].frame, low, high, coarse[0].coarse_gsd_m, features)
    found: list[Candidate] = []
    for plan, box in zip(coarse, boxes, strict=True):
        grid = cropped(part_of_box(whole, *box, MARGIN_PX))
        found += _of_one(plan, grid, full, features, threads)
    return _apart(sorted(found, key=lambda c: -c.stands_out))


def _of_one(plan: SearchPlan, grid: MapGrid, full: FrameLevel, features: Features, threads: int) -> Iterator[Candidate]:
    """Peaks under one lean."""
    level = reduced(full, grid.gsd_m / plan.frame_gsd_m)
    frame = Resampled(level, plan, grid.A_ne_pix[:, :2], features, PASS_SERVES)
    volume = search_window(grid, frame, plan, threads=threads)
    allowed = region(volume, grid, plan) & (volume.score > NO_SCORE)
    scores = volume.score[allowed]
    if scores.size < 2 or not (deviation := float(scores.std())) > 0:
        return
    middle, side_m = float(np.median(scores)), math.sqrt(plan.area_m2)
    heights = footprint_heights(grid, plan)
    for peak in find_peaks(volume, allowed, max(3.0, APART * side_m / grid.gsd_m), PEAKS_EACH):
        pose = pose_of_peak(peak, grid, plan, heights)
        view = np.asarray((pose.p_ned_m + to_view(pose, plan.ground_up_m))[:2])
        yield Candidate(pose, (peak.score - middle) / deviation, plan.agl_m, side_m, view)


def _apart(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Without those that look at the same ground as a better one under nearly the same attitude."""
    kept: list[Candidate] = []
    for candidate in candidates:
        if not any(_same(candidate, other) for other in kept):
            kept.append(candidate)
    return kept


def _same(a: Candidate, b: Candidate) -> bool:
    cos = (float(np.trace(a.pose.R_ned_cam.T @ b.pose.R_ned_cam)) - 1) / 2
    return cos > APART_COS and math.hypot(*(a.view_ne_m - b.view_ne_m)) < APART * min(a.side_m, b.side_m)
