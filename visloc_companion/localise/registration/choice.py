"""Which of the refined candidates is taken: the one for which all looks at the ground and the prior speak together.

The score is one correlation, and faint ground (gullies of a decimetre, 0.28 points a square metre) favours another place by it as
easily as not. What the claims are computed from for the place that is taken (leads.py, claims.py), is known of every candidate
here; what their rivals reach is the same for all of them. Where that leaves a doubt, unchanged ground is asked as well.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.claims import MOST_BOWL_M, MOST_CHI2, POWER
from visloc_companion.localise.registration.evidence import prior_chi2
from visloc_companion.localise.registration.lasting import Lasting
from visloc_companion.localise.registration.leads import leads_of, parts_z
from visloc_companion.localise.registration.pair import Pair
from visloc_companion.localise.registration.parts import MOST
from visloc_companion.localise.registration.search import find_places
from visloc_companion.localise.registration.settle import Settled, has_slid
from visloc_companion.localise.registration.similarity import about, scale_of, yaw_of
from visloc_companion.localise.registration.slopes import Ground, ground_of
from visloc_companion.types import FloatArray

REFINED = 4
"""Places of a search that are refined."""
CLEAR_LEAD = 0.5
"""A place that leads by less by all looks is doubtful. Of 744 cases of level normal (seeds 31 and 41, half of them gullies and
0.28 points a square metre) all 17 that were wrong led by less, and 2 to 3 % of the right ones."""
LOOKS, SCORE, CHI2, BOWL, BLOCKS = 12.6, 5.54, -0.484, -4.13, 1.21
"""Log-odds: of all looks at once, the score to the power of claims.POWER, the squared distance from the prior, a metre of bowl
and the share of blocks that agree. Those of claims.WEIGHTS as they were fitted on answers that the score alone had chosen."""
GROUND, MOST_NATS = 0.3, 60.0
"""Of a doubtful place: log-odds of a nat by which the ground that has not changed (lasting.py) makes it less likely than the
likeliest place of all, and how many of these count at most. As much a nat as the slopes over 6 m had; nats of the right place are
20 to 80 more than those of others (landscapes 160 and 161)."""
LOST_NATS = 10.0
"""Last steps that lose so many of the ground have left the place."""


class Choice:
    """Of candidates of one pair."""

    def __init__(self, pair: Pair, prior: RegistrationPrior) -> None:
        self._pair, self._prior = pair, prior
        self._merits: dict[Settled, float] = {}
        self._nats: dict[Settled, float] = {}
        self._ground: Ground | None = None
        self._lasting: Lasting | None = None

    def best(self, settled: list[Settled]) -> Settled:
        """The candidate with the greatest merit, of those that stayed where they had started, if any did."""
        stayed = [s for s in settled if not has_slid(s, self._pair)]
        return max(stayed or settled, key=self.merit)

    def merit(self, settled: Settled) -> float:
        """Log-odds of a candidate being right, but for a constant of the pair; with the ground's once there is a doubt."""
        if settled not in self._merits:
            self._merits[settled] = self._merit(settled)
        return self._merits[settled] + GROUND * max(self._lacking(settled), -MOST_NATS)

    def strayed(self, polished: Settled, found: Settled) -> bool:
        """Whether last steps have left the place that the ground tells, where it was asked."""
        return self._lacking(found) - self._lacking(polished) > LOST_NATS

    def _lacking(self, settled: Settled) -> float:
        """Nats of the ground less those of the likeliest place; 0 where there was no doubt."""
        if self._lasting is None:
            return 0.0
        if settled not in self._nats:
            self._nats[settled] = self._lasting.at(settled.refined.T) - self._lasting.most
        return self._nats[settled]

    def ground_leads(self, settled: Settled, rest: Iterable[Settled]) -> tuple[float, float]:
        """How much likelier than any other place a candidate is by the slopes of the ground (nats), which alone tell places apart
        where nothing stands, and, than the `rest` as well, by the ground that has not changed; 0 at least, and where there was no
        doubt."""
        if self._ground is None or self._lasting is None:
            return 0.0, 0.0
        lasting = self._lasting.lead(settled.refined.T, (other.refined.T for other in rest))
        return max(self._ground.lead(settled.refined.T), 0.0), max(lasting, 0.0)

    def doubted(self, settled: Settled) -> list[FloatArray]:
        """(4, 4) Where else to start, where a candidate hardly leads by all looks: the best places of the finer relief and of
        the ground, which counts from here on, and the one that is best by all looks at the candidate's heading and scale. None
        where it is no matter of doubt, and none twice."""
        if self._ground is not None:
            return []
        T = settled.refined.T
        leads = leads_of(self._pair, T, self._prior)
        if leads.joint >= CLEAR_LEAD:
            return []
        self._ground, self._lasting = ground_of(self._pair, self._prior), Lasting(self._pair, self._prior)
        starts = [place.T for place in find_places(self._pair.finer, self._prior, REFINED)[0]] + self._lasting.starts(REFINED)
        if leads.rival_m is not None:
            shift = np.append(leads.rival_m - self._pair.centre_m[:2], 0.0)
            starts.append(about(self._pair.centre_m, yaw_of(T), scale_of(T), shift))
        return starts

    def by_ground(self) -> list[FloatArray]:
        """(4, 4) The likeliest places by the ground alone, as it places the source; none where there was no doubt."""
        return [] if self._lasting is None else [self._lasting.placed(T) for T in self._lasting.starts(REFINED)]

    def _merit(self, settled: Settled) -> float:
        T, score = settled.refined.T, max(settled.found.score, 0.0)
        looks = math.atanh(min(score, MOST)) + parts_z(self._pair, T, self._prior)
        chi2 = min(prior_chi2(T, self._pair.centre_m, self._prior), MOST_CHI2)
        bowl_m = min(abs(settled.refined.bowl_m), MOST_BOWL_M)
        return float(LOOKS * looks + SCORE * score**POWER + CHI2 * chi2 + BOWL * bowl_m + BLOCKS * settled.found.blocks)
