"""Candidates of the exhaustive search, refined level by level: from the score volume to the strongest match."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from visloc_companion.localise import align
from visloc_companion.localise.answer import Stopwatch
from visloc_companion.localise.blocks import BlockMatches, share_returning
from visloc_companion.localise.candidates.block_pose import block_pose
from visloc_companion.localise.candidates.descent import Descended, Rivals, descend_resampled
from visloc_companion.localise.candidates.frame_features import DescentFeatures, Seen, frame_features
from visloc_companion.localise.candidates.hypotheses import (
    arms_to_view,
    footprint_heights,
    peaks_in_region,
    pose_of_peak,
    region,
    search_box,
    search_window,
    unsearched,
)
from visloc_companion.localise.candidates.modes import PlaceMode, Searched, searched
from visloc_companion.localise.candidates.ranking import RankWeights, Standing, lead
from visloc_companion.localise.candidates.tilt_starts import likeliest, starts
from visloc_companion.localise.features.base import Features
from visloc_companion.localise.frame import FrameLevel, reduced
from visloc_companion.localise.mapped.ground import sigma_slope_rad
from visloc_companion.localise.mapped.map_part import reaches_all
from visloc_companion.localise.mapped.map_suns import MapSuns
from visloc_companion.localise.mapped.relit_tiles import Lit, RelitTiles
from visloc_companion.localise.mapped.window import MAX_SIDE_PX, map_grid, part_of_box, searched_map, thinned
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid
from visloc_companion.localise.plan import UNTIMED, SearchPlan, view_box
from visloc_companion.localise.pose import PoseEstimate, PriorTerm, heading_from, to_view
from visloc_companion.localise.verify import block_z
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import FloatArray, PosePrior, Sun

COARSE_STEPS, FINE_STEPS = 5, 4
MAX_CANDIDATES, MAX_FINE = 10, 5
PEAK_SHARE, DESCENT_SHARE, FINE_SHARE = 0.55, 0.7, 0.75
"""Of the best one's score: a peak counts, it deserves a descent (else it is taken to gain as much as the best one did), and where
its descent ended deserves the fine level."""
SAME_PX = 1.0
"""A descent that comes so near to where another ended leads there too."""
ONE_PLACE_PX = 2.0
"""Candidates that the fine level brings so near to each other, the camera and what it looks at, are one place: blocks that lie so
near agree (blocks.AGREE_PX)."""
MARGIN_PX = 8
ENOUGH_PX = 80
"""Larger footprints are aligned on every other pixel of every other row."""
MIN_COARSE_SCORE = 0.05
SAME_GSD = 1e-3
"""Share by which resolutions may differ and count as one: a stored level has the metres that the map's scale gives it where it is
read, a few parts in ten million more or less from candidate to candidate. What is made of the frame for one serves the other."""


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """One frame to be matched to one map: the features to search with, those to refine with, and the watch of the map's side.

    Where it is `lit` the map is refined on as it would look under the frame's sun; `sun_seen`: where the frame itself shows that.
    """

    plan: SearchPlan
    prior: PosePrior
    full: FrameLevel
    ref: ReferenceMap
    watch: Stopwatch
    features: Features
    fine_features: Features
    rank: RankWeights
    temperature: float
    frames: dict[tuple[str, float], DescentFeatures] = field(default_factory=dict)
    levels: dict[float, FrameLevel] = field(default_factory=dict)
    threads: int = 1
    suns: MapSuns = field(default_factory=MapSuns)
    relit: RelitTiles = field(default_factory=RelitTiles)
    lit: Lit | None = None
    sun_seen: Sun | None = None

    def frame(self, grid: MapGrid, features: Features) -> DescentFeatures:
        """The frame's features for a map window's resolution, made once."""
        key = features.name, _same_of(self.levels, grid.gsd_m)
        if key not in self.frames:
            self.frames[key] = frame_features(self.level(key[1]), self.plan, grid.A_ne_pix[:, :2], features)
        return self.frames[key]

    def refinement(self, gsd_m: float) -> Features:
        """Features for a resolution: those searched with are at hand, and stronger, where there is nothing finer."""
        return self.features if 0.95 < gsd_m / self.plan.coarse_gsd_m < 1.05 else self.fine_features

    def level(self, gsd_m: float) -> FrameLevel:
        """The frame at about a ground sample distance, made once."""
        key_m = _same_of(self.levels, gsd_m)
        if key_m not in self.levels:
            self.levels[key_m] = reduced(self.full, gsd_m / self.plan.frame_gsd_m)
        return self.levels[key_m]

    @property
    def map_side(self) -> AbstractContextManager[object]:
        """What the map takes to be read under: what a map under the frame's sun takes counts as the frame's."""
        return self.watch if self.lit is None else UNTIMED

    def window(self, pose: CameraPose, gsd_m: float, features: Features, margin_px: int) -> MapGrid:
        """The features of the map that a pose sees, and of a margin; under the frame's sun where that is looked at. Raises
        OutsideMap."""
        low, high = view_box(self.plan, pose)
        margin_m = margin_px * gsd_m
        return map_grid(self.ref, self.plan.frame, low - margin_m, high + margin_m, gsd_m, features, self.lit)

    def view_ne_m(self, pose: CameraPose) -> FloatArray:
        """(2,) the ground that the camera's axis meets: what tells places apart where the tilt is not known."""
        return np.asarray((pose.p_ned_m + to_view(pose, self.plan.ground_up_m))[:2])

    def whole_prior(self) -> PriorTerm:
        """Attitude, heading and height of the prior: what keeps the descent of a faint match together."""
        up_m = -float(self.plan.pose.p_ned_m[2])
        R = self.plan.pose.R_ned_cam
        return PriorTerm(R, self.prior.sigma_tilt_rad, self.prior.sigma_yaw_rad, up_m, self.prior.sigma_h_m)


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """A candidate refined at a level, with the blocks' independent check and the pose that they give. `seen`: the features of the
    frame, under both weights, as the descended pose rectified them to the map's window `grid` that the blocks were matched on."""

    descended: Descended
    coarse_score: float
    blocks: BlockMatches
    estimate: PoseEstimate | None
    gsd_m: float
    returning: Callable[[], float]
    """Share of the blocks that agree in both directions (blocks.py); worked out when it is asked for."""
    grid: MapGrid
    seen: Seen


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What the exhaustive search found: peaks refined at the search level, best first, and the posterior; by the prior,
    the probability of the places that it left `unsearched`; the window of the map that it searched."""

    candidates: list[Descended]
    search: Searched
    unsearched: float
    grid: MapGrid

    @property
    def modes(self) -> list[PlaceMode]:
        """All modes of the posterior, by falling mass."""
        return self.search.modes


def find_candidates(task: Task) -> Found:
    """Peaks of the exhaustive search, each refined at the search level, and what it leaves open. Raises OutsideMap."""
    plan = task.plan
    with task.watch:
        low, high = search_box(plan)
        grid = searched_map(task.ref, plan.frame, low, high, plan.coarse_gsd_m, task.features)
    stride = _stride(plan, grid.gsd_m)
    frame = task.frame(grid, task.features)
    volume = search_window(grid, frame, plan, threads=task.threads)
    radius_px = max(3.0, 0.06 * math.sqrt(plan.area_m2) / grid.gsd_m)
    peaks = peaks_in_region(volume, grid, plan, MAX_CANDIDATES, radius_px)
    heights = footprint_heights(grid, plan)
    found: list[Descended] = []
    for peak in peaks:
        if peak.score < PEAK_SHARE * peaks[0].score:
            break
        start = pose_of_peak(peak, grid, plan, heights)
        if peak.score < DESCENT_SHARE * peaks[0].score:
            found.append(Descended(start, peak.score * found[0].score / peaks[0].score, np.zeros((6, 6))))
            continue
        with task.watch:
            around = part_of_box(grid, *view_box(plan, start), MARGIN_PX)
            part, part_descent = thinned(around, stride), align.prepare(around, stride)
        near, rivals = frame.about(start, part, stride), Rivals(found, SAME_PX * grid.gsd_m)
        tilted = starts(start, plan.ground_up_m, task.prior.sigma_tilt_rad)
        ends = [descend_resampled(near, at, part, part_descent, task.whole_prior(), COARSE_STEPS, rivals) for at in tilted]
        if apart := [end for end, joined in ends if not joined]:
            found.append(likeliest(apart, plan.pose.R_ned_cam, task.prior.sigma_tilt_rad, task.rank[0] + task.rank[4]))
    temperature = task.temperature * grid.gsd_m / math.sqrt(plan.area_m2)
    search = searched(volume, region(volume, grid, plan), grid, temperature, arms_to_view(plan))
    most_m = MAX_SIDE_PX * grid.gsd_m
    left_out = unsearched(plan, math.inf if reaches_all(task.ref, plan.frame, low, high, most_m) else most_m)
    return Found(sorted(found, key=lambda c: -c.score), search, left_out, grid)


def best_match(task: Task, matches: list[Match]) -> tuple[Match, float]:
    """The strongest of the refined candidates, at least one, and its lead (nats)."""
    strengths = [standing(task, match).strength(task.rank) for match in matches]
    best = int(np.argmax(strengths))
    return matches[best], lead(strengths, best)


def refined_candidates(task: Task, candidates: list[Descended]) -> list[Match]:
    """The best candidates, refined at the fine level, each place once. Raises OutsideMap."""
    matches: list[Match] = []
    for candidate in distinct(candidates, 2 * task.plan.coarse_gsd_m, task.view_ne_m)[:MAX_FINE]:
        if candidate.score < max(MIN_COARSE_SCORE, FINE_SHARE * candidates[0].score):
            break
        match = refined(task, candidate.pose, candidate.score, task.plan.fine_gsd_m)
        if match is not None:
            matches.append(match)
    return _once_each(task, matches)


def _once_each(task: Task, matches: list[Match]) -> list[Match]:
    """The matches, in their order, without those that came to where a stronger one is: they would be its rivals otherwise."""
    strengths = [standing(task, match).strength(task.rank) for match in matches]
    kept: list[int] = []
    for k in np.argsort(-np.array(strengths), kind="stable").tolist():
        radius_m = ONE_PLACE_PX * matches[k].gsd_m
        if all(_apart_m(task, matches[k].descended.pose, matches[other].descended.pose) > radius_m for other in kept):
            kept.append(k)
    return [matches[k] for k in sorted(kept)]


def _apart_m(task: Task, a: CameraPose, b: CameraPose) -> float:
    """How far two cameras, or what they look at, lie apart."""
    views = task.view_ne_m(a) - task.view_ne_m(b)
    return max(math.hypot(*views), math.hypot(*(a.p_ned_m - b.p_ned_m)[:2]))


def standing(task: Task, match: Match) -> Standing:
    """What a candidate is ranked by."""
    blocks = match.blocks.agrees
    return Standing(
        score=match.descended.score,
        coarse_score=match.coarse_score,
        block_z=block_z(len(blocks), float(blocks.sum())),
        prior_chi2=prior_chi2(task, match.descended.pose),
        footprint_px=math.sqrt(task.plan.area_m2) / match.gsd_m,
    )


def sharpened(task: Task, match: Match) -> Match:
    """The match refined once more at the finest useful resolution, where that is finer and does not lead elsewhere."""
    if task.plan.finest_gsd_m > 0.85 * match.gsd_m:
        return match
    finest = refined(task, match.descended.pose, match.coarse_score, task.plan.finest_gsd_m)
    if finest is None or finest.estimate is None:
        return match
    apart = task.view_ne_m(finest.descended.pose) - task.view_ne_m(match.descended.pose)
    if math.hypot(*apart) > 4 * match.gsd_m:
        return match
    return finest


def refined(task: Task, start: CameraPose, coarse_score: float, gsd_m: float) -> Match | None:
    """Lucas-Kanade, blocks and pose at one resolution; None where frame and map do not overlap."""
    features = task.refinement(gsd_m)
    with task.map_side:
        grid = task.window(start, gsd_m, features, MARGIN_PX)
        stride = _stride(task.plan, gsd_m)
        thin, descent = thinned(grid, stride), align.prepare(grid, stride)
    frame, level = task.frame(grid, features), task.level(grid.gsd_m)
    end, _ = descend_resampled(frame.about(start, thin, stride), start, thin, descent, task.whole_prior(), FINE_STEPS)
    if end.score <= 0:
        return None
    leaning = sigma_slope_rad(grid.surface_up_m, math.sqrt(task.plan.area_m2))
    found = block_pose(frame, level.K, grid, end.pose, task.whole_prior(), leaning)
    if found.pose is not end.pose:
        end, _ = descend_resampled(frame.about(start, thin, stride), found.pose, thin, descent, task.whole_prior(), 0)
    returning = partial(share_returning, found.blocks, grid, found.values, found.weight)
    seen = found.values, found.weight
    return Match(end, coarse_score, found.blocks, found.estimate, grid.gsd_m, returning, grid, seen)


def searched_window(task: Task, searched: MapGrid, pose: CameraPose, margin_px: int) -> MapGrid:
    """What a pose sees of the window that was `searched`, and a margin; under the frame's sun where that is looked at. Raises
    OutsideMap."""
    if task.lit is None:
        return part_of_box(searched, *view_box(task.plan, pose), margin_px)
    return task.window(pose, searched.gsd_m, task.features, margin_px)


def distinct(candidates: Sequence[Descended], radius_m: float, view_ne_m: Callable[[CameraPose], FloatArray]) -> list[Descended]:
    """The candidates without those whose camera looks at ground within a radius of what a better one's does."""
    kept: list[tuple[Descended, FloatArray]] = []
    for candidate in candidates:
        view = view_ne_m(candidate.pose)
        if all(math.hypot(*(view - other)) > radius_m for _, other in kept):
            kept.append((candidate, view))
    return [candidate for candidate, _ in kept]


def prior_chi2(task: Task, pose: CameraPose) -> float:
    """Squared distance of position and heading from the prior, in sigmas."""
    offset = pose.p_ned_m[:2] - task.plan.pose.p_ned_m[:2]
    heading = heading_from(pose.R_ned_cam, task.plan.pose.R_ned_cam)
    turn = heading / max(task.prior.sigma_yaw_rad, math.radians(0.5))
    return float(offset @ np.linalg.solve(task.plan.cov_ne_m2, offset)) + turn * turn


def _same_of(known_m: Iterable[float], gsd_m: float) -> float:
    """The first of the known ground sample distances (m) that is the same resolution (SAME_GSD), else the one asked for."""
    return next((known for known in known_m if abs(known - gsd_m) <= SAME_GSD * gsd_m), gsd_m)


def _stride(plan: SearchPlan, gsd_m: float) -> int:
    """How a window is thinned for the alignment: what is low-passed and large loses nothing by it."""
    return 2 if math.sqrt(plan.area_m2) > ENOUGH_PX * gsd_m else 1
