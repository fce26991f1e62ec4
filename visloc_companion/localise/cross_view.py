"""Method `cross-view`: a frame of which neither heading nor lean is known (T1 of the published tasks, after Shetty & Gao 2019).

The published networks guess the pose at once, from the frame alone. Here every attitude that the prior allows is searched
(attitude_search.py), and what stands out is localised as `deep` does, from a prior that the search has narrowed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from visloc_companion.errors import OutsideMap, Reason
from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import R_from_quat
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.localise.answer import Stopwatch, no_fix
from visloc_companion.localise.candidates.attitude_search import Candidate, searched_leans
from visloc_companion.localise.candidates.guess import (
    FROM_ANSWER,
    FROM_SEARCH,
    Guess,
    Spread,
    guess_of_candidate,
    guess_of_fix,
    narrowed,
    prior_sigmas,
)
from visloc_companion.localise.candidates.leans import STEP_RAD, leans
from visloc_companion.localise.candidates.tilt import set_right
from visloc_companion.localise.dense import deep_localiser
from visloc_companion.localise.features.base import Features
from visloc_companion.localise.frame import check_pixels, full_level
from visloc_companion.localise.ortho_rectify import CameraPose
from visloc_companion.localise.plan import SearchPlan, make_plan
from visloc_companion.localise.pose import to_view
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.localise.verify import MAX_CHI2_SIGMA, unknown_attitude_wrong
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.types import CameraModel, Fix, FloatArray, Image, LocaliseRequest, NoFix, PosePrior, Quat

REFINED, FOLLOWED, ROUNDS = 10, 3, 2
"""Candidates that are localised; of these the best, that are localised again from where they came to be, so many times."""
REPORTED = 9
"""Candidates that a fix or refusal reports: as many patches as the published system weighs."""
SAME_SHARE = 0.1
"""Of the footprint's side: answers that look at ground so near are one place."""


class CrossViewLocaliser:
    """protocols.Localiser for frames of unknown attitude. Nothing is kept between frames, or random."""

    method = "cross-view"

    def __init__(self, model: CameraModel, settings: LocaliserSettings, features: Features) -> None:
        self._model, self._settings, self._features = model, settings, features
        self._deep = deep_localiser(model, replace(settings, max_probability_wrong=1.0), features)

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The pose of the camera, or why there is none. Never raises for what an image or a place may contain."""
        watch = Stopwatch()
        try:
            return self._localised(replace(request, prior=set_right(request.prior)), pixels, ref, watch)
        except OutsideMap as outside:
            return no_fix(request, self.method, watch, (Reason.OUTSIDE_MAP, outside.what))

    def _localised(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap, watch: Stopwatch) -> Fix | NoFix:
        prior, settings = request.prior, self._settings
        if why := check_pixels(pixels, self._model):
            return no_fix(request, self.method, watch, why)
        plans = [make_plan(_leaning(prior, q), self._model, ref, settings, watch) for q in leans(prior)]
        usable = [plan for plan in plans if isinstance(plan, SearchPlan)]
        if not usable:
            return no_fix(request, self.method, watch, next(why for why in plans if not isinstance(why, SearchPlan)))
        full = full_level(pixels, self._model)
        candidates = searched_leans(usable, full, ref, self._features, watch, settings.threads)
        asked = _Asked(self._deep, request, pixels, ref, usable[0].ground_up_m, watch)
        numbers = _numbers(candidates, usable[0]) | {"leans": float(len(usable))}
        answer = asked.likeliest([guess_of_candidate(c, usable[0].frame, ref) for c in candidates[:REFINED]])
        if isinstance(answer, NoFix):
            return no_fix(request, self.method, watch, (answer.reason, answer.detail), dict(answer.evidence) | numbers)
        fix, ahead = answer
        numbers = dict(fix.evidence) | numbers | {"ahead": ahead}
        p = numbers["p_wrong"] = unknown_attitude_wrong(numbers)
        if why := _why_not(fix, prior, p, settings.max_probability_wrong):
            return no_fix(request, self.method, watch, why, numbers)
        evidence = tuple((numbers | {"map_ms": watch.map_ms}).items())
        return replace(fix, method=self.method, probability_wrong=p, elapsed_ms=watch.elapsed_ms, evidence=evidence, tilt=None)


@dataclass(frozen=True, slots=True)
class _Answer:
    """What was said about a guess."""

    fix: Fix
    score: float
    side_m: float


class _Asked:
    """The localiser that is asked about each guess of a frame's pose."""

    def __init__(
        self,
        deep: Localiser,
        request: LocaliseRequest,
        pixels: Image,
        ref: ReferenceMap,
        ground_up_m: float,
        watch: Stopwatch,
    ) -> None:
        self._deep, self._request, self._pixels, self._ref = deep, request, pixels, ref
        self._ground_up_m, self._watch = ground_up_m, watch

    def likeliest(self, guesses: Sequence[Guess]) -> tuple[Fix, float] | NoFix:
        """The answer that resembles the map most, and by how much more than what looks elsewhere; else the first refusal."""
        first = [self._near(guess, FROM_SEARCH) for guess in guesses]
        found = sorted((answer for answer in first if isinstance(answer, _Answer)), key=lambda a: -a.score)
        if not found:
            return next((answer for answer in first if isinstance(answer, NoFix)), self._nothing())
        best = max((self._followed(answer) for answer in found[:FOLLOWED]), key=lambda a: a.score)
        elsewhere = [a.score for a in found if self._apart_m(a.fix, best.fix) > SAME_SHARE * best.side_m]
        return best.fix, best.score - max(elsewhere, default=0.0)

    def _followed(self, answer: _Answer) -> _Answer:
        """The answer asked again from where it is, as often as it bears it."""
        for _ in range(ROUNDS):
            again = self._near(guess_of_fix(answer.fix, answer.side_m, self._ground_up_m), FROM_ANSWER)
            if not isinstance(again, _Answer):
                break
            answer = again
        return answer

    def _near(self, guess: Guess, known: Spread) -> _Answer | NoFix:
        prior = narrowed(self._request.prior, guess, known)
        answer = self._deep.localise(replace(self._request, prior=prior), self._pixels, self._ref)
        evidence = dict(answer.evidence)
        self._watch.add_map_ms(evidence.get("map_ms", 0.0))
        return answer if isinstance(answer, NoFix) else _Answer(answer, evidence["score"], guess.side_m)

    def _nothing(self) -> NoFix:
        why = Reason.NO_MATCH, "no likeness within the search region"
        return no_fix(self._request, self._deep.method, self._watch, why)

    def _apart_m(self, a: Fix, b: Fix) -> float:
        """Between the ground that two answers look at: under a tilt that is not known the places above it are less sure."""
        north, east, _ = ned_from_geo(a.place, b.place)
        apart = np.array([north, east]) + _arm(a, self._ground_up_m) - _arm(b, self._ground_up_m)
        return math.hypot(*apart.tolist())


def _arm(fix: Fix, ground_up_m: float) -> FloatArray:
    """(2,) metres north, east from a camera to the ground that its axis meets."""
    pose = CameraPose(np.array([0.0, 0.0, -fix.place.h_amsl_m]), R_from_quat(fix.q_ned_frd) @ R_FRD_CAM)
    return to_view(pose, ground_up_m)[:2]


def _leaning(prior: PosePrior, q_ned_frd: Quat) -> PosePrior:
    return replace(prior, q_ned_frd=q_ned_frd, sigma_tilt_rad=min(prior.sigma_tilt_rad, STEP_RAD / 2))


def _why_not(fix: Fix, prior: PosePrior, p: float, limit: float) -> tuple[Reason, str] | None:
    sigmas = prior_sigmas(fix, prior)
    if sigmas > MAX_CHI2_SIGMA:
        return Reason.INCONSISTENT_WITH_PRIOR, f"{sigmas:.1f} sigma from the prior"
    return (Reason.NO_MATCH, f"probability of being wrong {p:.3f}") if p > limit else None


def _numbers(candidates: Sequence[Candidate], plan: SearchPlan) -> dict[str, float]:
    """The likeliest candidates: metres north, east and up of the prior, and how far each stands out."""
    numbers: dict[str, float] = {"candidates": float(len(candidates))}
    for k, candidate in enumerate(candidates[:REPORTED], 1):
        north, east, down = (candidate.pose.p_ned_m - plan.pose.p_ned_m).tolist()
        at = {"north_m": north, "east_m": east, "up_m": -down, "stands_out": candidate.stands_out}
        numbers |= {f"patch{k}_{name}": value for name, value in at.items()}
    return numbers
