"""The default: exhaustive search of height maps over the prior's region, bounded refinement, judged by what it sees.

The search compares what stands out of the upper surface (high-passed at 8 m): unlike heights, that knows no tilt, no bowl and
no growth of a whole forest. The few best places are refined, and the one that all looks at the ground favour is taken; where it
hardly leads by them, what stands out at 2 m is searched too, and how the ground lies that has not changed.
"""

from __future__ import annotations

from visloc_companion.errors import Reason
from visloc_companion.localise.registration.base import NotRegistered, Registered, RegistrationPrior
from visloc_companion.localise.registration.choice import REFINED, Choice
from visloc_companion.localise.registration.headings import Headings
from visloc_companion.localise.registration.pair import make_pair
from visloc_companion.localise.registration.search import find_places, work
from visloc_companion.localise.registration.settle import Settled, Settler, has_slid, too_little_overlap
from visloc_companion.localise.registration.unchanged import is_clear, placed_by_unchanged
from visloc_companion.localise.registration.upright import polished
from visloc_companion.types import FloatArray

MOST_WORK = 2e9
"""About two minutes of a core. 66 m x 66 m within ±500 m and ±25° of the prior are an eighth of it."""


class HeightSearchRegistration:
    """As base.RegistrationMethod. A search of more than `most_work` (search.work) is declined.

    `by_score`: the candidate of the highest score is taken, and nothing is searched twice; what is alike beside it is told by
    the blocks that have not changed. The claims of stereo clouds rest on that (structure/claims.py).
    `by_unchanged`: with it, where that leaves a doubt, all that has not changed takes the place and tells it (unchanged.py).
    """

    def __init__(
        self, max_probability_wrong: float, most_work: float = MOST_WORK, *, by_score: bool = False, by_unchanged: bool = False
    ) -> None:
        self.max_probability_wrong, self.most_work, self.by_score = max_probability_wrong, most_work, by_score
        self.by_unchanged = by_unchanged

    def __call__(self, source_m: FloatArray, reference_m: FloatArray, prior: RegistrationPrior) -> Registered | NotRegistered:
        """Search, refine, judge."""
        pair = make_pair(source_m, reference_m, prior)
        if isinstance(pair, NotRegistered):
            return pair
        cost = work(pair, prior)
        if cost > self.most_work:
            return NotRegistered(Reason.SEARCH_TOO_WIDE, f"{cost:.1e} cells times hypotheses, of {self.most_work:.1e} at most")
        places, scores = find_places(pair, prior, REFINED)
        settler = Settler(pair, prior)
        settled = settler.settled(place.T for place in places)
        if not settled:
            return too_little_overlap()
        choice = None if self.by_score else Choice(pair, prior)
        doubting = choice if 2 * cost <= self.most_work else None
        if doubting is not None:
            settled += _elsewhere(doubting, settler, doubting.best(settled))
        found, headings = _with_turned(settled, settler, choice)
        best, besides = polished(settler, found, prior)
        if doubting is not None and (more := _elsewhere(doubting, settler, best)):
            settled += more
            found, headings = _with_turned(settled, settler, choice)
            best, besides = polished(settler, found, prior)
        if choice is not None and (has_slid(best, pair) or choice.strayed(best, found)):
            best, besides = found, []
        unchanged = None
        if self.by_unchanged and not is_clear(best, settled, settler):
            best, unchanged = placed_by_unchanged(best, [place.T for place in places], settler)
        if has_slid(best, pair):
            what = f"the refinement slid {best.slid_m:.1f} m from where the search had found it"
            return NotRegistered(Reason.REFINEMENT_DIVERGED, what)
        rest = [s for s in settled if s is not found or unchanged is not None] + besides  # else it may be another place
        ground_leads = (0.0, 0.0) if choice is None else choice.ground_leads(best, rest)
        return settler.answer(best, rest, scores, headings, self.max_probability_wrong, ground_leads, self.by_score, unchanged)


def _elsewhere(choice: Choice, settler: Settler, best: Settled) -> list[Settled]:
    """Candidates more, where the best one is doubtful: refined, and those of the ground as it places them, too."""
    starts = choice.doubted(best)
    return settler.settled(starts) + settler.held(choice.by_ground()) if starts else []


def _with_turned(settled: list[Settled], settler: Settler, choice: Choice | None) -> tuple[Settled, Headings]:
    """The best candidate, once the best of the other headings at its place is one as well, and how well these would do."""
    found = _best(settled, choice)
    headings = settler.headings(found)
    settled += settler.turned(found, headings)
    return _best(settled, choice), headings


def _best(settled: list[Settled], choice: Choice | None) -> Settled:
    """By all looks, or by the score."""
    return max(settled, key=lambda s: s.found.score) if choice is None else choice.best(settled)
