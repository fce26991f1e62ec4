"""The places that a frame may show: how likely each is, what that leaves of the best match, and which stay open without a fix.

The refined candidates are told apart by their strength (ranking.py) without its term for the prior. A mode of the search
(modes.py) that was not refined is taken to have gained by it what the best candidate's rivals did, for its mass: over ground that
repeats itself that is as much as the best, elsewhere next to nothing. The best match is then no likelier than its share of all of
them under the prior; the navigator gets the shares without the prior, which it must not count again with every frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from visloc_companion.localise.candidates.claims import claimed_covariance
from visloc_companion.localise.candidates.matching import Match, Task, prior_chi2, standing
from visloc_companion.localise.candidates.modes import MODE_RADIUS, PlaceMode
from visloc_companion.types import FloatArray, GeoPoint, OpenPlace

LEAST_EVIDENCE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """Probabilities (K,) of the refined matches and (M,) of the modes `ne_m` (M, 2) that are none of them, without the prior."""

    of_matches: FloatArray
    of_modes: FloatArray
    ne_m: FloatArray


def weighed(task: Task, matches: Sequence[Match], best: Match, modes: Sequence[PlaceMode]) -> Weighed:
    """What the search and the refinement of at least one candidate, one of them the best, say."""
    strengths = np.array([replace(standing(task, match), prior_chi2=0.0).strength(task.rank) for match in matches])
    shares = np.exp(strengths - strengths.max())
    shares /= shares.sum()
    mass = np.array([m.mass for m in modes])
    at = np.array([(m.north_m, m.east_m) for m in modes]).reshape(-1, 2)
    views = np.array([(m.view_north_m, m.view_east_m) for m in modes]).reshape(-1, 2)
    ends = np.array([task.view_ne_m(match.descended.pose) for match in matches])
    apart_m = np.linalg.norm(views[:, None] - ends, axis=2)
    belongs = apart_m <= MODE_RADIUS * math.sqrt(task.plan.area_m2)
    nearest = apart_m.argmin(1)
    of_match = np.array([mass[belongs[:, k] & (nearest == k)].sum() for k in range(len(matches))])
    others = ~belongs.any(1)
    rival = np.array([match is not best for match in matches])
    if not float(of_match[rival].sum()) > 0.0:
        rival[:] = True
    gain = float(shares[rival].sum()) / max(float(of_match[rival].sum()), LEAST_EVIDENCE)
    elsewhere = gain * mass[others]
    whole = 1.0 + float(elsewhere.sum())
    return Weighed(shares / whole, elsewhere / whole, at[others])


def share_of(task: Task, matches: Sequence[Match], best: Match, likely: Weighed) -> float:
    """Probability that the best match is the place, were the vehicle at one of those that are weighed, under the prior."""
    chi2 = np.array([prior_chi2(task, match.descended.pose) for match in matches])
    off = likely.ne_m - task.plan.pose.p_ned_m[:2]
    chi2_of_modes = np.einsum("mi,ij,mj->m", off, np.linalg.inv(task.plan.cov_ne_m2), off)
    least = min([*chi2, *chi2_of_modes])
    of_matches = likely.of_matches * np.exp(-(chi2 - least) / 2)
    whole = float(of_matches.sum() + (likely.of_modes * np.exp(-(chi2_of_modes - least) / 2)).sum())
    return float(of_matches[[match is best for match in matches]].sum()) / whole if whole > 0 else 0.0


def open_places(task: Task, matches: Sequence[Match], likely: Weighed, right: float) -> tuple[OpenPlace, ...]:
    """The matches that have a pose, likeliest first. `right`: probability that the frame matches the map anywhere."""
    places = []
    for k in np.argsort(-likely.of_matches, kind="stable").tolist():
        match, evidence = matches[k], right * float(likely.of_matches[k])
        if match.estimate is None or evidence < LEAST_EVIDENCE:
            continue
        pose = match.estimate.pose
        lat, lon = task.ref.to_geo(*task.plan.frame.to_map(pose.p_ned_m[:2]))
        (nn, ne), (en, ee) = claimed_covariance(match.estimate, match.gsd_m)[:2, :2].tolist()
        place = GeoPoint(float(lat), float(lon), -float(pose.p_ned_m[2]))
        places.append(OpenPlace(place, ((nn, ne), (en, ee)), math.log(evidence)))
    return tuple(places)
