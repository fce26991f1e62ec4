"""The default: exhaustive search of height maps over the prior's region, bounded refinement, judged by what it sees.

The search compares what stands out of the upper surface (high-passed at 8 m): unlike heights, that knows no tilt, no bowl and
no growth of a whole forest. The few best places are refined, and the one whose relief agrees best is taken.
"""

from __future__ import annotations

from visloc_companion.errors import Reason
from visloc_companion.localise.registration.base import NotRegistered, Registered, RegistrationPrior
from visloc_companion.localise.registration.pair import make_pair
from visloc_companion.localise.registration.search import find_places, work
from visloc_companion.localise.registration.settle import Settler, too_little_overlap
from visloc_companion.localise.registration.upright import polished
from visloc_companion.types import FloatArray

REFINED = 4
"""Places that are refined."""
SLIDE_M, SLIDE_CELLS = 6.0, 3.0
"""A refinement that goes farther from its start than this has slid away."""
MOST_WORK = 2e9
"""About two minutes of a core. 66 m x 66 m within ±500 m and ±25° of the prior are an eighth of it."""


class HeightSearchRegistration:
    """As base.RegistrationMethod. A search of more than `most_work` (search.work) is declined."""

    def __init__(self, max_probability_wrong: float, most_work: float = MOST_WORK) -> None:
        self.max_probability_wrong, self.most_work = max_probability_wrong, most_work

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
        settled = [s for place in places if (s := settler.settle(place.T)) is not None]
        if not settled:
            return too_little_overlap()
        found = max(settled, key=lambda s: s.found.score)
        headings = settler.headings(found)
        settled += settler.turned(found, headings)
        found = max(settled, key=lambda s: s.found.score)
        best, besides = polished(settler, found, prior)
        if best.slid_m > max(SLIDE_M, SLIDE_CELLS * pair.source.cell_m):
            what = f"the refinement slid {best.slid_m:.1f} m from where the search had found it"
            return NotRegistered(Reason.REFINEMENT_DIVERGED, what)
        rest = [s for s in settled if s is not found] + besides
        return settler.answer(best, rest, scores, headings, self.max_probability_wrong)
