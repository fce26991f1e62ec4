"""From a start to an answer: refined on the surfaces, looked at, claimed or declined. Shared by all methods."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from visloc_companion.errors import Reason
from visloc_companion.localise.registration.base import NotRegistered, Registered, RegistrationPrior
from visloc_companion.localise.registration.claims import answer
from visloc_companion.localise.registration.consensus import consensus
from visloc_companion.localise.registration.correlation import Scores
from visloc_companion.localise.registration.evidence import Agreement, agreement, evidence_of
from visloc_companion.localise.registration.headings import (
    MOST_APART_RAD,
    Headings,
    apart_rad,
    are_two,
    headings_at,
    is_turned,
    starts,
)
from visloc_companion.localise.registration.nearby import of_blocks, spread_m2
from visloc_companion.localise.registration.pair import Pair, make_pair
from visloc_companion.localise.registration.polish import polish
from visloc_companion.localise.registration.refine import Refined, refine
from visloc_companion.localise.registration.search import APART_M, runner_up, search
from visloc_companion.localise.registration.similarity import (
    from_origin,
    moved,
    near_origin_m,
    scale_of,
    with_linear,
    yaw_of,
)
from visloc_companion.localise.registration.surfaces import SourceCells, Surface, cells_of, met, surface_of
from visloc_companion.types import FloatArray

STEPS = 20
ASTRAY = 0.1
"""Last steps that lose so much of the score have left the place."""
MARGIN_M = 12.0
"""The reference is looked at this far beyond the source."""
SLIDE_M, SLIDE_CELLS = 6.0, 3.0
"""A refinement that goes farther from its start than this has slid away."""
HELD_M = 2.0
"""1-sigma, east and north, of a place that is not refined."""
TURNED = 1
"""Other headings of a place that are refined."""


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """A refined candidate, how well it agrees, where (2,) its source's middle started, and how far that went, horizontally; the
    heading that it started with."""

    refined: Refined
    found: Agreement
    start_m: FloatArray
    slid_m: float
    start_yaw_rad: float


class Settler:
    """Refines and judges candidates of one pair."""

    def __init__(self, pair: Pair, prior: RegistrationPrior) -> None:
        self._rounding_m2: FloatArray = np.sum([s.unknown_m2 for s in pair.sampling], axis=0)
        growth_m = math.sqrt(prior.sigma_growth_m**2 + float(self._rounding_m2[2]))  # heights do not tell less of either
        self.pair, self.prior = pair, replace(prior, sigma_growth_m=growth_m)
        self.cells: SourceCells = cells_of(pair.source, pair.source_relief, pair.centre_m)
        self._blocks: tuple[FloatArray, tuple[float, FloatArray]] | None = None

    def settle(self, start: FloatArray, steps: int = STEPS) -> Settled | None:
        """Refine a start whose height is not known yet, in so many steps; None where hardly anything of the source lies on the
        reference."""
        surface, relief = self._near(start)
        lifted = self._lifted(start, surface)
        return None if lifted is None else self._settled(lifted, surface, relief, steps)

    def settled(self, starts: Iterable[FloatArray]) -> list[Settled]:
        """Those of the starts that can be refined."""
        return [s for start in starts if (s := self.settle(start)) is not None]

    def polished(self, settled: Settled) -> Settled:
        """The same after the last steps; as it was where they go astray."""
        surface, relief = self._near(settled.refined.T)
        agreed = consensus(self.cells, relief, settled.refined.T)
        T = with_linear(settled.refined.T[:3, :3], np.zeros(3), settled.refined.T[:3, 3] + np.append(agreed.shift_m, 0))
        refined = polish(self.cells, surface, replace(settled.refined, T=T), self.prior, agreed.trust)
        if refined is None:
            return settled
        polished = self._with_agreement(refined, relief, settled.start_m, settled.start_yaw_rad)
        return settled if polished.found.score < settled.found.score - ASTRAY else polished

    def sharpened(self, settled: Settled) -> Settled | None:
        """After the last steps from where it is, by the blocks' trust there; None where too little lies on the reference."""
        surface, relief = self._near(settled.refined.T)
        trust = consensus(self.cells, relief, settled.refined.T, 0.0).trust
        refined = polish(self.cells, surface, settled.refined, self.prior, trust)
        return None if refined is None else self._with_agreement(refined, relief, settled.start_m, settled.start_yaw_rad)

    def looked_at(self, T: FloatArray) -> Settled | None:
        """T as it is; None where hardly anything of the source lies on the reference."""
        return self._settled(T, *self._near(T), 0)

    def of_blocks(self, settled: Settled) -> tuple[float, FloatArray]:
        """As nearby.of_blocks; where it was asked about last it is known."""
        T = settled.refined.T
        if self._blocks is None or not np.array_equal(self._blocks[0], T):
            self._blocks = T, of_blocks(self.cells, self._near(T)[1], T)
        return self._blocks[1]

    def held(self, starts: Iterable[FloatArray], sigma_m: float = HELD_M) -> list[Settled]:
        """Those of the starts of which enough lies on the reference, lifted and otherwise as they are: known to `sigma_m`."""
        found = []
        for start in starts:
            if (settled := self.settle(start, 0)) is not None:
                placed = settled.refined.placed + np.diag([sigma_m**2, sigma_m**2, 0.0, 0.0])
                found.append(replace(settled, refined=replace(settled.refined, placed=placed)))
        return found

    def headings(self, settled: Settled) -> Headings:
        """How well others would do at its place."""
        return headings_at(self.pair, settled.refined.T, self.prior)

    def turned(self, settled: Settled, headings: Headings) -> list[Settled]:
        """The best of the other headings at its place, refined; none where the prior leaves none."""
        return self.settled(starts(self.pair, settled.refined.T, headings, TURNED))

    def answer(
        self,
        best: Settled,
        rest: list[Settled],
        scores: Scores,
        headings: Headings,
        max_probability_wrong: float,
        ground_leads: tuple[float, float] = (0.0, 0.0),
        by_blocks: bool = False,
        unchanged: tuple[float, FloatArray] | None = None,
    ) -> Registered | NotRegistered:
        """The claim for the best of the candidates, against what else scores well, also turned, and the rest of them, which are
        refined too; `ground_leads` as Evidence's `ground_lead` and `lasting_lead`. `by_blocks`: those that have not changed say
        what is alike beside it, not all; `unchanged` where all that has not changed was asked: Evidence's `unchanged_lead` and
        (2, 2) what is alike by that."""
        T, apart = best.refined.T, apart_rad(self.pair)
        here = moved(T, self.pair.centre_m)[:2]
        others = [s for s in rest if are_two(self.pair, s.refined.T, T)]
        away = [s.found.score for s in others]
        rival = max([runner_up(self.pair, scores, here), headings.rival([yaw_of(T)], apart), *away])
        begun_here = [s for s in (best, *rest) if np.hypot(*(s.start_m - here)) < APART_M]
        refined_yaws = [yaw_of(T), *(s.start_yaw_rad for s in begun_here)]
        unrefined = max(
            runner_up(self.pair, scores, np.array([here, best.start_m, *(s.start_m for s in rest)])),
            headings.rival(refined_yaws, apart),
        )
        blocks_lead, alike_m2 = self.of_blocks(best) if by_blocks else (0.0, spread_m2(self.pair, scores, here, self.prior))
        unchanged_lead, alike_m2 = unchanged or (0.0, alike_m2)
        placed = best.refined.placed.copy()
        placed[:2, :2] += alike_m2
        refined = replace(best.refined, placed=placed)
        rivals = rival, max([unrefined, *away])
        turned = [s.refined.T for s in others if is_turned(self.pair, s.refined.T, T, MOST_APART_RAD)]
        evidence = evidence_of(self.pair, best.found, refined, rivals, turned, scores.unseen, self.prior)
        if turned:
            ground_leads = (0.0, 0.0)  # the best heading of a place is all that the ground was asked for
        ground_lead, lasting_lead = ground_leads
        evidence = replace(evidence, ground_lead=ground_lead, lasting_lead=lasting_lead)
        evidence = replace(evidence, blocks_lead=blocks_lead, unchanged_lead=unchanged_lead)
        return answer(self._with_rounding(refined), evidence, self.prior, max_probability_wrong)

    def _settled(self, start: FloatArray, surface: Surface, relief: Surface, steps: int) -> Settled | None:
        refined = refine(self.cells, surface, relief, start, self.prior, steps)
        if refined is None:
            return None
        return self._with_agreement(refined, relief, moved(start, self.pair.centre_m)[:2], yaw_of(start))

    def _with_agreement(self, refined: Refined, relief: Surface, start_m: FloatArray, start_yaw_rad: float) -> Settled:
        slid = moved(refined.T, self.pair.centre_m)[:2] - start_m
        agreed = agreement(self.pair, self.cells, relief, refined.T, self.prior)
        return Settled(refined, agreed, start_m, float(np.hypot(*slid)), start_yaw_rad)

    def _with_rounding(self, refined: Refined) -> Refined:
        """With what the rounding of coordinates leaves unknown of the place; how the reliefs hold it is no other for it."""
        east, north, _ = self._rounding_m2
        return replace(refined, placed=refined.placed + np.diag([east, north, 0, 0]))

    def _near(self, T: FloatArray) -> tuple[Surface, Surface]:
        """Heights and relief of the reference about where T puts the source."""
        near = moved(T, self.pair.centre_m)[:2], 1.5 * self.pair.half_m + MARGIN_M
        return surface_of(self.pair.reference.around(*near)), surface_of(self.pair.reference_relief.around(*near))

    def _lifted(self, start: FloatArray, surface: Surface) -> FloatArray | None:
        on = met(self.cells, surface, start)
        if not len(on.at_m):
            return None
        lifted = start.copy()
        lifted[2, 3] += np.median(on.height_m - on.at_m[:, 2])
        return lifted


def judged(
    align: Callable[[FloatArray, FloatArray], FloatArray],
    clouds_m: tuple[FloatArray, FloatArray],
    prior: RegistrationPrior,
    max_probability_wrong: float,
) -> Registered | NotRegistered:
    """The answer of a method that finds T (4, 4) of (source, reference) points by itself.

    T is taken as it is, and judged against all other places at its heading and scale, and all other headings at its place.
    Raises ValueError as base.RegistrationMethod.
    """
    pair = make_pair(*clouds_m, prior)
    if isinstance(pair, NotRegistered):
        return pair
    origin = near_origin_m(pair.reference_m)  # small_gicp's voxels end at some 500 km
    T = from_origin(align(pair.source_m - origin, pair.reference_m - origin), origin)
    if not np.isfinite(T).all() or np.linalg.det(T[:3, :3]) <= 0:
        return NotRegistered(Reason.NO_MATCH, "no similarity was found")
    settler = Settler(pair, prior)
    settled = settler.looked_at(T)
    if settled is None:
        return too_little_overlap()
    scores = search(pair, [(yaw_of(T), scale_of(T))], prior)
    headings = settler.headings(settled)
    return settler.answer(settled, settler.turned(settled, headings), scores, headings, max_probability_wrong)


def has_slid(settled: Settled, pair: Pair) -> bool:
    """Whether a refinement has left the place that it started at."""
    return settled.slid_m > max(SLIDE_M, SLIDE_CELLS * pair.source.cell_m)


def too_little_overlap() -> NotRegistered:
    """The refusal where nothing could be refined."""
    return NotRegistered(Reason.LOW_OVERLAP, "too little of the source lies on the reference")
