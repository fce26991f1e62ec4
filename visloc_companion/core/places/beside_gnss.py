"""Whether the map is searched for the vehicle although GNSS is trusted: no frame is recognised near where GNSS has it.

A GNSS that has been false since before take-off has nothing that contradicts it. The filter starts where it says, and frames are
searched for about that place alone, so that one that is further off hides the vehicle for good. So, as long as the filter rests
on GNSS and on no fix, and frames that show ground are refused there, every other question is one of the search of the whole map
(core/places/place_search.py); the others go on about GNSS. That GNSS is so false is unlikely from the start, which counts against
a place that is found: it is taken with the fewer answers against it, RISK.
"""

from __future__ import annotations

from visloc_companion.core.filter.belief import Belief
from visloc_companion.core.places import place_search
from visloc_companion.core.satellites import gnss_odds
from visloc_companion.errors import Reason
from visloc_companion.types import NoFix

AFTER_NS, FEWEST = 30_000_000_000, 20
"""So long after the first refused frame, and so many of them: a flight begins over ground that the map knows."""
RISK = place_search.RISK * gnss_odds.RATE_PER_S * AFTER_NS * 1e-9
"""Probability that a place is false up to which it is taken: less, as a GNSS that is false by then is less likely than one of
these searches is to have the vehicle on its map."""
NOT_THERE = (
    *(Reason.NO_MATCH, Reason.AMBIGUOUS, Reason.BLOCKS_DISAGREE, Reason.INCONSISTENT_WITH_PRIOR, Reason.OUTSIDE_MAP),
    *(Reason.REFINEMENT_DIVERGED, Reason.TOO_FEW_FEATURES, Reason.POSE_FAILED, Reason.NO_PARALLAX, Reason.LOW_OVERLAP),
)
"""What a frame of other ground than that about GNSS comes to."""


class BesideGnss:
    """Counts frames that are refused about a GNSS that no fix has borne out yet."""

    def __init__(self) -> None:
        self._started_ns: int | None = None
        self._since_ns, self._refused, self._begun = 0, 0, False
        self._search_next, self._off_map = True, False

    def refused(self, answer: NoFix, belief: Belief | None, *, held_there: bool) -> None:
        """Take an answer to a question about where the filter (`belief`) has the vehicle; `held_there` by a GNSS that is trusted,
        or by what the autopilot was sent before the daemon came."""
        if belief is None or belief.last_fix_ns is not None or not held_there or answer.reason not in NOT_THERE:
            return
        outside = answer.reason is Reason.OUTSIDE_MAP
        if belief.started_ns != self._started_ns:
            self._started_ns, self._since_ns, self._refused, self._begun = belief.started_ns, answer.t_ns, 0, False
            self._off_map = outside
        self._off_map &= outside
        self._refused += 1
        self._begun |= self._refused >= FEWEST and answer.t_ns - self._since_ns >= AFTER_NS

    def missed(self, belief: Belief | None) -> bool:
        """Whether a frame was refused about where a filter (`belief`) was held that no fix has borne out yet."""
        return belief is not None and belief.last_fix_ns is None and belief.started_ns == self._started_ns

    def due(self, belief: Belief | None) -> bool:
        """Whether the map is searched; once so, also where GNSS is trusted no more, until a fix is taken or the filter starts
        anew. One that was found false before is not far from where the vehicle is: what contradicts it saw it move away."""
        return self.missed(belief) and self._begun

    @property
    def off_map(self) -> bool:
        """Whether all frames were refused because there is no map: a search from there would go about it for minutes."""
        return self._off_map

    def takes_turn(self) -> bool:
        """Whether the next question is one of the search; every other one is."""
        turn, self._search_next = self._search_next, not self._search_next
        return turn
