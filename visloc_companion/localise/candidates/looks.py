"""One look at a frame's candidates: refined on some features, and what the strongest of them shows and claims.

The first look refines on gradients, which are sharp. Over a wood that is bare in the picture and in leaf on the map they agree on
nothing, though the place is right: the gradients' sign is another in every crown. The network's features still do, to a metre or
three, so a frame that the first look declines is looked at again through them. Each look has coefficients of its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeGuard

import numpy as np

from visloc_companion.errors import Reason
from visloc_companion.localise.candidates.block_votes import REACH_PX, share_here, votes
from visloc_companion.localise.candidates.claims import claimed_covariance, horizontal_sigma
from visloc_companion.localise.candidates.matching import Found, Match, Task, best_match, refined_candidates, searched_window
from visloc_companion.localise.candidates.modes import MODE_RADIUS, mass_near
from visloc_companion.localise.candidates.open_places import Weighed, share_of, weighed
from visloc_companion.localise.candidates.quarters import quarters_log_odds
from visloc_companion.localise.mapped.window import part_of_box
from visloc_companion.localise.plan import view_box
from visloc_companion.localise.pose import PoseEstimate, heading_from
from visloc_companion.localise.verify import (
    Evidence,
    Weights,
    beside_others,
    block_z,
    crowded,
    fewer_places,
    or_by_quarters,
    outvoted,
    probability_wrong,
    refusal,
)

Why = tuple[Reason, str]
LEAST_BLOCK_Z = 2.0
"""Quarters tell which place it is, and not where in it: they are asked where blocks of the fine level agree beyond chance, by so
many of its standard deviations. Along a shore that has moved all four show the same wrong place, and those blocks do not."""


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """The strongest of the refined candidates, with its pose and evidence.

    `likely`: how likely each candidate and each open mode of the search is, `share` what that leaves of the best under the prior;
    `votes` what the frame's blocks on their own leave of it; `alone`: probability that the best is wrong by its own looks, and by
    its `quarters` (nats), where they were asked; `p` beside the others and by the blocks.
    """

    task: Task
    matches: Sequence[Match]
    match: Match
    estimate: PoseEstimate
    evidence: Evidence
    likely: Weighed
    share: float
    votes: float
    alone: float
    p: float
    quarters: float | None = None

    def why_not(self, limit: float) -> Why | None:
        """Why it is declined at a limit of the probability of being wrong, or None."""
        share = or_by_quarters(self.share, self.evidence, self.quarters)
        beside = beside_others(self.alone, share)
        return refusal(self.evidence, self.alone, limit) or crowded(beside, share, limit) or outvoted(self.p, self.votes, limit)


def looked(task: Task, found: Found, weights: Weights) -> Look | Why:
    """Refine what the search found, and judge the strongest. Raises OutsideMap."""
    matches = refined_candidates(task, found.candidates)
    if not matches:
        return Reason.NO_MATCH, "no likeness within the search region"
    match, lead = best_match(task, matches)
    if match.estimate is None:
        return Reason.POSE_FAILED, "the blocks do not determine a pose"
    evidence = _evidence(task, match, match.estimate, lead, found)
    likely = weighed(task, matches, match, found.modes)
    share, alone = share_of(task, matches, match, likely), probability_wrong(evidence, weights)
    voted = _voted(task, match, found)
    p = beside_others(alone, share * voted)
    return Look(task, matches, match, match.estimate, evidence, likely, share, voted, alone, p)


def with_quarters(look: Look, found: Found, weights: Weights) -> Look:
    """The look with what the quarters of its frame show of all places that were searched (quarters.py); as it is where the prior
    leaves few of them, or blocks hardly agree with it."""
    evidence = look.evidence
    if fewer_places(evidence.prior_px) > 0 or block_z(evidence.blocks, evidence.agreeing) < LEAST_BLOCK_Z:
        return look
    task, pose = look.task, look.match.descended.pose
    window = part_of_box(found.grid, *view_box(task.plan, pose), margin_px=1)
    values, mask = task.frame(window, task.features).on_surface(pose, window)
    seen = values, mask * window.weight
    return _claiming(look, weights, quarters_log_odds(found.grid, window, seen, pose, task.plan, task.temperature))


def convincing(look: Look | Why | None, weights: Weights, limit: float) -> TypeGuard[Look]:
    """Whether there is a look, and it would not be declined at a limit if the prior left as many places as the weights are for.

    Where it leaves few, poor looks will do to say that it is this place, and better ones to say where.
    """
    if not isinstance(look, Look):
        return False
    anywhere = replace(look, evidence=replace(look.evidence, prior_px=math.inf))
    return _claiming(anywhere, weights, look.quarters).why_not(limit) is None


def _claiming(look: Look, weights: Weights, quarters: float | None) -> Look:
    alone = probability_wrong(look.evidence, weights, quarters)
    left = or_by_quarters(look.share * look.votes, look.evidence, quarters)
    return replace(look, alone=alone, p=beside_others(alone, left), quarters=quarters)


def surer(first: Look | Why, second: Look | Why, limit: float) -> Look | Why:
    """The look that is not declined at a limit, else the one that is less likely to be wrong; the first of equals."""
    if not isinstance(second, Look):
        return first
    if not isinstance(first, Look):
        return second
    declined = first.why_not(limit) is not None, second.why_not(limit) is not None
    return second if (declined[1], second.p) < (declined[0], first.p) else first


def _voted(task: Task, best: Match, found: Found) -> float:
    """The share that the frame's blocks on their own give the best match, through the features of the search, on the map under
    the frame's sun where that is looked at."""
    pose = best.descended.pose
    part = searched_window(task, found.grid, pose, REACH_PX)
    values, mask = task.frame(part, task.features).on_surface(pose, part)
    return share_here(votes(part, values, mask * part.weight, task.temperature))


def _evidence(task: Task, best: Match, estimate: PoseEstimate, lead: float, found: Found) -> Evidence:
    plan, prior, pose = task.plan, task.prior, estimate.pose
    view = task.view_ne_m(best.descended.pose)
    apart_m = [math.hypot(*(task.view_ne_m(c.pose) - view)) for c in found.candidates]
    others = [c.score for c, off_m in zip(found.candidates, apart_m, strict=True) if off_m > 4 * plan.coarse_gsd_m]
    heading = heading_from(pose.R_ned_cam, plan.pose.R_ned_cam)
    offset = pose.p_ned_m[:2] - plan.pose.p_ned_m[:2]
    return Evidence(
        score=best.descended.score,
        coarse_score=best.coarse_score,
        runner_up=min(2.0, max(others, default=0.0) / max(best.coarse_score, 1e-6)),
        lead=lead,
        mode_mass=mass_near(found.modes, view, MODE_RADIUS * math.sqrt(plan.area_m2)),
        blocks=len(best.blocks.agrees),
        agreeing=float(best.blocks.agrees.sum()),
        footprint_px=math.sqrt(plan.area_m2) / plan.fine_gsd_m,
        scatter=estimate.scatter,
        height_sigmas=abs(float(pose.p_ned_m[2] - plan.pose.p_ned_m[2])) / max(prior.sigma_h_m, 1.0),
        yaw_sigmas=abs(heading) / max(prior.sigma_yaw_rad, math.radians(0.5)),
        position_sigmas=math.sqrt(float(offset @ np.linalg.solve(plan.cov_ne_m2, offset))),
        tilt_sigmas=estimate.tilt_sigmas,
        returning=best.returning(),
        sigma_px=horizontal_sigma(claimed_covariance(estimate, best.gsd_m)) / plan.coarse_gsd_m,
        prior_px=float(np.linalg.det(plan.cov_ne_m2)) ** 0.25 / plan.coarse_gsd_m,
    )
