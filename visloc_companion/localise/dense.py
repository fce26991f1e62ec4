"""The dense localiser: exhaustive search, Lucas-Kanade, block correspondences, pose with covariance, verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial, reduce

from visloc_companion.errors import OutsideMap, Reason
from visloc_companion.localise.answer import Stopwatch, fix, no_fix
from visloc_companion.localise.candidates.claims import claimed_covariance
from visloc_companion.localise.candidates.looks import Look, Why, convincing, looked, surer, with_quarters
from visloc_companion.localise.candidates.map_ends import map_at_sides
from visloc_companion.localise.candidates.matching import Found, Task, find_candidates, sharpened
from visloc_companion.localise.candidates.modes import search_numbers
from visloc_companion.localise.candidates.open_places import open_places
from visloc_companion.localise.candidates.ranking import DEEP_RANK, GRADIENT_RANK, RankWeights
from visloc_companion.localise.candidates.relight import under_the_frames_sun, with_sun_seen
from visloc_companion.localise.candidates.tilt import beyond, seen_tilt, set_right
from visloc_companion.localise.candidates.tilt_starts import tilt_is_known
from visloc_companion.localise.candidates.together import solved_together
from visloc_companion.localise.features.base import Features
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.frame import full_level
from visloc_companion.localise.mapped.map_light import MapLight
from visloc_companion.localise.ortho_rectify import CameraPose
from visloc_companion.localise.plan import SearchPlan, planned
from visloc_companion.localise.settings import LocaliserSettings, Looks
from visloc_companion.localise.verify import AGAIN_WEIGHTS, DEEP_WEIGHTS, GRADIENT_WEIGHTS, Weights, block_z
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import CameraModel, Fix, Image, LocaliseRequest, NoFix

MOST_LEAN_COS, SURE_TILT_RAD = math.cos(math.radians(30.0)), math.radians(0.7)
"""A camera that leans further sees woods from the side: on training cases second looks err by 1.3 times their claim beyond it
where the tilt is known to a degree (0.9 to 1.0 times below it), by 0.8 times where it is known to 0.6."""
LOOK_AGAIN_ABOVE, LEAST_OF_ONE_PLACE = 0.05, 0.25
"""A frame is looked at again where the first look is wrong with more than the former probability and the search gives one place
the latter or more: on training cases every right one had 0.27. Where much is searched none has it, and it would take long."""


TOLD_UNSEARCHED = 0.02
"""Probability of what was left out of the search from which a refusal says so."""


@dataclass(frozen=True, slots=True)
class Fitted:
    """What was fitted for a method's features: weights of being right at the first look and, where there is one, at a second;
    of the ranking."""

    right: Weights
    rank: RankWeights
    temperature: float
    """Of the score volume's posterior, times the footprint's side in pixels."""
    again: Weights | None = None


class DenseLocaliser:
    """protocols.Localiser on dense features. Nothing is kept between frames but what the map is, or random."""

    def __init__(self, method: str, model: CameraModel, settings: LocaliserSettings, features: Features, fitted: Fitted) -> None:
        self.method = method
        self._model, self._settings, self._features, self._fitted = model, settings, features, fitted
        self._light = settings.light or MapLight()

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The pose of the camera, or why there is none. Never raises for what an image or a place may contain."""
        answer = self._localised(replace(request, prior=set_right(request.prior)), pixels, ref)
        return answer if isinstance(answer, NoFix) else replace(answer, tilt=beyond(answer.tilt, request.prior.tilt))

    def _localised(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        watch = Stopwatch()
        try:
            plan = planned(request.prior, pixels, self._model, ref, self._settings, watch)
            if not isinstance(plan, SearchPlan):
                return no_fix(request, self.method, watch, plan)
            full = full_level(pixels, self._model)
            rank, temperature = self._fitted.rank, self._fitted.temperature
            features, threads = self._features, self._settings.threads
            task = Task(
                plan,
                request.prior,
                full,
                ref,
                watch,
                features,
                GRADIENT,
                rank,
                temperature,
                threads=threads,
                suns=self._light.suns,
                relit=self._light.relit,
            )
            found = find_candidates(task)
            look = self._look(task, found)
            if isinstance(look, Look):
                return self._answer(request, look, found)
            return no_fix(request, self.method, watch, _and_unsearched(look, found), _of_search(found, plan))
        except OutsideMap as outside:
            return no_fix(request, self.method, watch, (Reason.OUTSIDE_MAP, outside.what))

    def _look(self, task: Task, found: Found) -> Look | Why:
        """The look that the settings ask for; of all, one that is accepted, rather under the frame's sun, or the surest."""
        if self._settings.looks is Looks.BOTH:
            return self._surest(task, found)
        second = None if self._settings.looks is Looks.FIRST else self._second(task, found)
        return self._asked(looked(task, found, self._fitted.right), found) if second is None else second

    def _surest(self, task: Task, found: Found) -> Look | Why:
        lit, right = None, self._fitted.right
        if task.prior.sun is not None and found.candidates:
            lit = self._lit(task, found, found.candidates[0].pose)
            if convincing(lit, right, LOOK_AGAIN_ABOVE):
                return lit
        first = looked(task, found, right)
        if task.prior.sun is None and isinstance(first, Look):
            pose = first.match.descended.pose
            first = replace(first, task=with_sun_seen(task, pose))
            lit = self._lit(first.task, found, pose)
        first = self._asked(first, found)
        if convincing(first, right, LOOK_AGAIN_ABOVE):
            return lit if convincing(lit, right, LOOK_AGAIN_ABOVE) else first
        others = [look for look in (lit, self._second(task, found)) if look is not None]
        return reduce(partial(surer, limit=LOOK_AGAIN_ABOVE), others, first)

    def _asked(self, first: Look | Why, found: Found) -> Look | Why:
        """A first look, its quarters asked where it is declined; not under a tilt that is not known, where the place is right and
        the answer far off more often than another place is taken for it."""
        right = self._fitted.right
        if self._fitted.again is None or not isinstance(first, Look) or convincing(first, right, LOOK_AGAIN_ABOVE):
            return first
        return with_quarters(first, found, right) if tilt_is_known(first.task.prior.sigma_tilt_rad) else first

    def _lit(self, task: Task, found: Found, pose: CameraPose) -> Look | Why | None:
        """A look at the map under the frame's sun, as it shows from a pose; None where it does not."""
        under = under_the_frames_sun(task, pose)
        return None if under is None else looked(under, found, self._fitted.right)

    def _second(self, task: Task, found: Found) -> Look | Why | None:
        """A look through the features of the search; None where it tells nothing more."""
        weights = self._fitted.again
        if weights is None or not _another_look_tells_more(task, found):
            return None
        return looked(replace(task, fine_features=task.features), found, weights)

    def _answer(self, request: LocaliseRequest, look: Look, found: Found) -> Fix | NoFix:
        task, plan, match = look.task, look.task.plan, look.match
        numbers = look.evidence.numbers() | {
            "block_z": block_z(look.evidence.blocks, look.evidence.agreeing),
            "agl_m": plan.agl_m,
            "p_wrong": look.p,
            "share": look.share,
            "votes": look.votes,
            **({} if look.quarters is None else {"quarters": look.quarters}),
            **_of_search(found, plan),
            "looks": 1.0 if task.fine_features is GRADIENT else 2.0,
            "lit": 0.0 if task.lit is None else 1.0,
            **search_numbers(found.search, plan.pose.p_ned_m),
        }
        if why := look.why_not(self._settings.max_probability_wrong):
            declined = no_fix(request, self.method, task.watch, _and_unsearched(why, found), numbers)
            places = open_places(task, look.matches, look.likely, 1 - look.alone)
            return replace(declined, open_places=places, footprint_m=math.sqrt(plan.area_m2))
        final = sharpened(task, match)
        estimate = solved_together(task, final, found.grid) or final.estimate or look.estimate
        covariance = claimed_covariance(estimate, final.gsd_m)
        sigma_m = self._settings.map_sigma_m
        pose = estimate.pose
        answer = fix(request, self.method, task.watch, plan, task.ref, pose, covariance, look.p, sigma_m, numbers)
        north, east = estimate.per_focal[:2].tolist()
        return replace(answer, tilt=seen_tilt(estimate, request.prior), per_focal_ne_m=(north, east), sun=task.sun_seen)


def _of_search(found: Found, plan: SearchPlan) -> dict[str, float]:
    """What is told of a search whatever it found."""
    return {"unsearched": found.unsearched, **map_at_sides(found.grid, plan)}


def _and_unsearched(why: Why, found: Found) -> Why:
    """A refusal that also says how much of the prior was left out, where that may be why nothing was found."""
    if found.unsearched < TOLD_UNSEARCHED:
        return why
    reason, detail = why
    return reason, f"{detail}; {100 * found.unsearched:.0f} % of where it may be was too far to be searched"


def _another_look_tells_more(task: Task, found: Found) -> bool:
    """Whether a second look is another one than the first, and not in vain. Under a tilt that is not known, over a map without a
    surface model, it was right no more often than the first, and surer of it."""
    finer = task.refinement(task.plan.fine_gsd_m) is not task.features
    one_place = bool(found.modes) and found.modes[0].mass >= LEAST_OF_ONE_PLACE
    sigma_tilt = task.prior.sigma_tilt_rad
    from_above = float(task.plan.pose.R_ned_cam[2, 2]) >= MOST_LEAN_COS or sigma_tilt <= SURE_TILT_RAD
    return finer and one_place and from_above and tilt_is_known(sigma_tilt)


def gradient_localiser(model: CameraModel, settings: LocaliserSettings) -> DenseLocaliser:
    """Method `gradient`: double-angle gradient orientation throughout."""
    return DenseLocaliser("gradient", model, settings, GRADIENT, Fitted(GRADIENT_WEIGHTS, GRADIENT_RANK, 1.04))


def deep_localiser(model: CameraModel, settings: LocaliserSettings, features: Features) -> DenseLocaliser:
    """Method `deep`: the network's features where candidates are found and judged; gradients where they are sharpened and, where
    these decline, the network's there, too (looks.py)."""
    fitted = Fitted(DEEP_WEIGHTS, DEEP_RANK, 0.673, AGAIN_WEIGHTS)
    return DenseLocaliser("deep", model, settings, features, fitted)
