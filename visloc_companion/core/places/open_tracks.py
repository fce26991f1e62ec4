"""Places that answers leave open, carried along the dead-reckoned track until later frames tell them apart.

Multiple-hypothesis tracking (Reid, "An algorithm for tracking multiple targets", 1979) of one vehicle: each place of a declined
answer (`NoFix.open_places`) becomes a hypothesis with a weight, moves as the vehicle does (travel.py), and is weighed by every
later answer; "none of them" keeps a weight of its own. One of them is a fix where it is wrong with a probability of at most RISK.

What an answer may say is limited so that ground which repeats itself decides nothing:

* A place that is not listed, or hardly, is less likely by MISS at the most, and by no more than what the answer leaves to places
  that it does not list; one that was not searched not at all.
* Listed places within a factor ALIKE are equally likely: copies of one place never differ by it.
* Answers count when the vehicle has moved on by SPACING of what a frame sees, and by the share of the ground that is new:
  neighbouring frames err together.

So no hypothesis wins over another by being seen, only over one that was looked for and is not there, more than once. A fix of a
frame that shows one place only ends it all, as it would without hypotheses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from visloc_companion.core import kalman
from visloc_companion.core.covariance import largest_sigma_m
from visloc_companion.core.odometry import OdometryTrack
from visloc_companion.core.places import hypotheses
from visloc_companion.core.places.hypotheses import H_POSITION, Hypothesis
from visloc_companion.core.places.travel import TravelLog
from visloc_companion.core.velocity.vouching import velocity_sigma_mps
from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.types import Fix, FloatArray, GeoPoint, LocaliseRequest, NoFix, Odometry, OpenPlace, Rejected, Vec2

RISK = 0.01
FEWEST_ANSWERS = 3
MOST = 8
MISS, ALIKE = 0.1, 2.0
SPACING = 0.5
GATE_SIGMA = 4.0
REACH_SIGMA = 2.8
"""A place within so many sigma of the prior was searched, the localiser's 3 less a margin for the picture's rim."""
UNMET = 0.1
"""Of a hypothesis that leads to a listed place, the share that stays where it is: that place may be another one."""
BLURRED = 0.15
"""A hypothesis that is known no better than to so many footprints could be confused with another's place: it is given up."""
FORGET_NS = 30_000_000_000
LEAST = 1e-4
PLACE_SHARE = 0.02
"""1-sigma of a place in footprints that is added to what its match claims: a place must not be missed for too sure a claim."""
FLAT = (1 - math.exp(-(REACH_SIGMA**2) / 2)) / (REACH_SIGMA**2 / 2)
"""Mean of exp(-chi2 / 2) over the searched region: what the prior says of a place that is not named."""


class OpenTracks:
    """The hypotheses and their weights; all places are metres north and east of one origin.

    A winner is wrong with a probability of at most RISK, and of no more than a fix may be (`max_probability_wrong`);
    `displacements`: what the camera saw of its motion, where another one takes that.
    """

    def __init__(self, max_probability_wrong: float = 0.05, displacements: OdometryTrack | None = None) -> None:
        self._risk = min(max_probability_wrong, RISK)
        self._travel = TravelLog(displacements)
        self._asked: LocaliseRequest | None = None
        self._origin: GeoPoint | None = None
        self._n_born = 0
        self._footprint_m = 1.0
        self.clear()

    def clear(self) -> None:
        """Forget all hypotheses: the vehicle is where the filter has it."""
        self._tracks: tuple[tuple[Hypothesis, float], ...] = ()
        self._none, self._answers, self._counted_ns = 1.0, 0, 0

    @property
    def weights(self) -> tuple[float, ...]:
        """Probability of each hypothesis; what they lack of 1 is that of none of them."""
        return tuple(weight for _, weight in self._tracks)

    def moving(self, t_ns: int, v_ne_mps: Vec2) -> None:
        """Take the velocity input (m/s)."""
        self._travel.velocity(t_ns, v_ne_mps)

    def moved(self, seen: Odometry) -> None:
        """Take what the camera saw of its own motion."""
        self._travel.odometry(seen)

    def asked(self, request: LocaliseRequest) -> None:
        """Keep in mind where the answer to this will have been searched for."""
        self._asked = request

    def answered(self, answer: NoFix, origin: GeoPoint, sigma_v_mps: float) -> Fix | None:
        """Weigh all by an answer; `sigma_v_mps`: 1-sigma of the velocity input. A fix of its method where only one is left.

        Only an answer of several places begins.
        """
        asked, places, footprint_m = self._asked, answer.open_places, answer.footprint_m
        if asked is None or asked.request_id != answer.request_id or footprint_m is None or not places:
            return None
        self._expire(answer.t_ns, origin)
        if not self._tracks and (answer.reason is not Reason.AMBIGUOUS or len(places) < 2):
            return None
        self._footprint_m = footprint_m
        if not self._weighed(answer.t_ns, places, asked, origin, sigma_v_mps):
            return None
        won = self._winner(answer.t_ns)
        return None if won is None else _fix(answer, asked, *won, origin)

    def _expire(self, t_ns: int, origin: GeoPoint) -> None:
        if self._tracks and (t_ns - self._counted_ns > FORGET_NS or not wgs84.same_spot(origin, self._origin)):
            self.clear()

    def _weighed(
        self, t_ns: int, places: Sequence[OpenPlace], asked: LocaliseRequest, origin: GeoPoint, sigma_v_mps: float
    ) -> bool:
        """Weigh all by listed places; False where they are of ground that frames showed which counted, or nothing is left."""
        new = self._new_ground(t_ns) if self._tracks else 1.0
        if new < SPACING:
            return False
        self._origin = origin
        carried = [(hypotheses.carried(h, t_ns, self._travel.between(h.t_ns, t_ns)), weight) for h, weight in self._tracks]
        clear = [(h, weight) for h, weight in carried if largest_sigma_m(h.cov_ne_m2) <= BLURRED * self._footprint_m]
        if carried and not clear:
            self.clear()
            return False
        self._none += sum(weight for _, weight in carried) - sum(weight for _, weight in clear)
        seen = _Seen(places, self._footprint_m, asked, origin, new)
        self._weigh(clear, seen, t_ns, velocity_sigma_mps(sigma_v_mps))
        self._counted_ns = t_ns
        self._answers += 1
        return True

    def _new_ground(self, t_ns: int) -> float:
        """Share of what a frame sees that no frame showed which counted, as if the vehicle had flown along a side of it."""
        if t_ns <= self._counted_ns:
            return 0.0
        return min(1.0, math.hypot(*self._travel.between(self._counted_ns, t_ns).moved_ne_m) / self._footprint_m)

    def _weigh(self, tracks: list[tuple[Hypothesis, float]], seen: _Seen, t_ns: int, sigma_v_mps: float) -> None:
        taken: set[int] = set()
        weighed: list[tuple[Hypothesis, float]] = []
        for h, weight in tracks:
            near = seen.near(h)
            taken.update(near)
            missed = seen.unlisted if seen.searched(h) else 1.0
            weighed.append((h, weight * missed * (UNMET if near else 1.0)))
            for k, share in near.items():
                met = _met(h, seen.at_ne_m[k], seen.cov_m2[k], t_ns)
                weighed.append((met, weight * share * float(seen.listed[k])))
        whole = float((seen.evidence * seen.prior).sum())
        left = max(seen.rest * FLAT, MISS * whole)
        for k in range(len(seen.evidence)):
            if k not in taken:
                share = float(seen.evidence[k] * seen.prior[k]) / (whole + left)
                weighed.append((self._born(t_ns, seen, k, sigma_v_mps), self._none * share))
        none = self._none * (left / (whole + left) if not tracks else seen.unlisted)
        self._keep(weighed, none)

    def _born(self, t_ns: int, seen: _Seen, k: int, sigma_v_mps: float) -> Hypothesis:
        self._n_born += 1
        north, east = seen.at_ne_m[k].tolist()
        h = hypotheses.born(self._n_born, t_ns, (north, east), 1.0, sigma_v_mps)
        P = h.P.copy()
        P[:2, :2] = seen.cov_m2[k]
        return replace(h, P=P, hits=1, tested_ns=t_ns)

    def _keep(self, weighed: Sequence[tuple[Hypothesis, float]], none: float) -> None:
        """The likeliest, those that are one place as one; what is dropped may still be it, so it goes to "none of them"."""
        best: list[tuple[Hypothesis, float]] = []
        for h, weight in sorted(weighed, key=lambda item: (-item[1], item[0].number)):
            same = next((k for k, (other, _) in enumerate(best) if hypotheses.same(h, other)), None)
            if same is None:
                best.append((h, weight))
            else:
                best[same] = best[same][0], best[same][1] + weight
        whole = none + sum(weight for _, weight in best)
        kept = [(h, weight / whole) for h, weight in best[:MOST] if weight >= LEAST * whole]
        self._tracks = tuple(kept)
        self._none = max(0.0, 1.0 - sum(weight for _, weight in kept))

    def _winner(self, t_ns: int) -> tuple[Hypothesis, float] | None:
        """The hypothesis that wins, and the probability that it is wrong."""
        if not self._tracks or self._answers < FEWEST_ANSWERS:
            return None
        h, weight = self._tracks[0]
        if 1 - weight > self._risk or h.hits < FEWEST_ANSWERS or h.tested_ns != t_ns:
            return None
        return h, 1 - weight


def _met(h: Hypothesis, at_ne_m: FloatArray, cov_m2: FloatArray, t_ns: int) -> Hypothesis:
    """After an answer that lists the place to which it leads."""
    got = kalman.update(h.x, h.P, at_ne_m, cov_m2, H_POSITION, gate_sigma=GATE_SIGMA)
    return h if isinstance(got, Rejected) else replace(h, x=got.x, P=got.P, hits=h.hits + 1, tested_ns=t_ns)


class _Seen:
    """An answer's places in metres north and east of the origin: `at_ne_m` (K, 2), `cov_m2` (K, 2, 2), `evidence` (K,), and what
    the prior says of each (`prior`, (K,)); the factor of each for a hypothesis (`listed`, (K,)), and of one `unlisted`."""

    def __init__(
        self, places: Sequence[OpenPlace], footprint_m: float, asked: LocaliseRequest, origin: GeoPoint, new: float
    ) -> None:
        self.at_ne_m: FloatArray = np.array([wgs84.ned_from_geo(p.place, origin)[:2] for p in places])
        self.cov_m2: FloatArray = np.array([p.cov_ne_m2 for p in places]) + (PLACE_SHARE * footprint_m) ** 2 * np.eye(2)
        self.evidence: FloatArray = np.exp([p.log_evidence for p in places])
        self.rest = max(0.0, 1.0 - float(self.evidence.sum()))
        most = float(self.evidence.max())
        self.unlisted = min(1.0, max(self.rest / most, MISS)) ** new
        self.listed: FloatArray = np.clip((ALIKE * self.evidence / most) ** new, self.unlisted, 1.0)
        self._centre = np.array(wgs84.ned_from_geo(asked.prior.place, origin)[:2])
        self._inverse = np.linalg.inv(np.array(asked.prior.cov_ne_m2))
        self.prior: FloatArray = np.array([math.exp(-self._chi2(at) / 2) for at in self.at_ne_m])

    def _chi2(self, at_ne_m: FloatArray) -> float:
        off = at_ne_m - self._centre
        return float(off @ self._inverse @ off)

    def searched(self, h: Hypothesis) -> bool:
        """Whether its place lay in the searched region."""
        return self._chi2(h.x[:2]) <= REACH_SIGMA**2

    def near(self, h: Hypothesis) -> dict[int, float]:
        """The listed places to which a hypothesis may lead, each with its share of the probability."""
        off = self.at_ne_m - h.x[:2]
        chi2 = np.einsum("ki,kij,kj->k", off, np.linalg.inv(self.cov_m2 + h.P[:2, :2]), off)
        within = {k: math.exp(-(c - chi2.min()) / 2) for k, c in enumerate(chi2.tolist()) if c <= GATE_SIGMA**2}
        return {k: share / sum(within.values()) for k, share in within.items()}


def _fix(answer: NoFix, asked: LocaliseRequest, h: Hypothesis, wrong: float, origin: GeoPoint) -> Fix:
    """A hypothesis as a fix of the answer's method; attitude and height are the prior's."""
    prior, place = asked.prior, wgs84.geo_from_ned((*h.place_ne_m, 0.0), origin)
    return Fix(
        answer.t_rx_ns,
        h.t_ns,
        answer.request_id,
        answer.frame_id,
        answer.method,
        replace(place, h_amsl_m=prior.place.h_amsl_m),
        prior.q_ned_frd,
        h.cov_ne_m2,
        prior.sigma_h_m,
        prior.sigma_yaw_rad,
        wrong,
        answer.elapsed_ms,
        (("answers", float(h.hits)),),
    )
