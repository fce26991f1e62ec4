"""One stretch of soundings against the elevation model: search, refinement of the likeliest places, judgement."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np

from visloc_companion.core.covariance import largest_sigma_m
from visloc_companion.errors import Reason
from visloc_companion.localise.candidates.posterior import posterior
from visloc_companion.localise.search import NO_SCORE
from visloc_companion.localise.terrain import refine as fine
from visloc_companion.localise.terrain.base import Kind, NoTerrainFix, Soundings, TerrainFix, TerrainPrior
from visloc_companion.localise.terrain.elevation import ElevationMap, Terrain
from visloc_companion.localise.terrain.fitting import fitting_of, independent_share
from visloc_companion.localise.terrain.neighbours import of_neighbours, squared_sigmas, weights_of
from visloc_companion.localise.terrain.noise import HeightNoise
from visloc_companion.localise.terrain.refine import Fitting, Refined
from visloc_companion.localise.terrain.settings import TerrainSettings
from visloc_companion.localise.terrain.settle import settled
from visloc_companion.localise.terrain.thin import lowest
from visloc_companion.localise.terrain.verify import MIN_SOUNDINGS, Evidence, probability_wrong, refusal
from visloc_companion.localise.terrain.volume import Stretch, Volume, search
from visloc_companion.types import FloatArray, Vec2

SIGMAS = 3.0
MIN_KNOWN_REGION = 0.5
MODES = 4
LEAST_MASS = 1e-4
COARSEST_M = 120.0
SAME_CELLS = 2.0
LATE_SHARE, FEWEST_LATE = 0.6, 100
"""Of a stretch that is too long to be searched under a wide prior, the latest part is, while so many soundings remain."""


def locate(
    soundings: Soundings, prior: TerrainPrior, elevation: ElevationMap, settings: TerrainSettings
) -> TerrainFix | NoTerrainFix:
    """Where the vehicle was at the soundings' `t_ns`, or why that cannot be told. Deterministic, one thread."""
    if len(soundings.points_m) < MIN_SOUNDINGS:
        return NoTerrainFix(soundings.t_ns, Reason.TOO_FEW_FEATURES, f"{len(soundings.points_m)} soundings")
    thinned = lowest(soundings, settings.thin_cell_m)
    if len(thinned.points_m) < MIN_SOUNDINGS:
        return NoTerrainFix(soundings.t_ns, Reason.TOO_FEW_FEATURES, f"{len(thinned.points_m)} cells with soundings")
    thinned, planned = _searchable(thinned, prior, elevation, settings)
    reach = _reach_m(thinned, prior)
    if planned is None:
        detail = (
            f"three sigma of the prior are {max(reach):.0f} m with {prior.sigma_drift_mps:.1f} m/s of drift: too much to search"
        )
        return NoTerrainFix(soundings.t_ns, Reason.AMBIGUOUS, detail)
    cell, hypotheses = planned
    coarse = _window(elevation, thinned, prior, reach, cell)
    if float(coarse.known.mean()) < MIN_KNOWN_REGION:
        return NoTerrainFix(soundings.t_ns, Reason.OUTSIDE_MAP, "the elevation model does not cover where the prior looks")
    temper = independent_share(thinned, settings)
    slope = coarse.slope_rms()
    stretches = [Stretch(fine.placed(thinned, h), prior.h_amsl_m + thinned.points_m[:, 2]) for h in hypotheses]
    noise = HeightNoise(math.hypot(elevation.sigma_m, soundings.sigma_m, slope * cell * SEARCH_BLUR))
    volume = search(coarse, stretches, noise, prior.p_ne_m, reach, prior.sigma_h_m, temper)
    starts = _starts(volume, coarse, prior, hypotheses)
    if not starts:
        return NoTerrainFix(soundings.t_ns, Reason.LOW_OVERLAP, "too few soundings lie on known elevations")
    same = abs(cell - elevation.cell_m) < 1e-6
    terrain = coarse if same else _window(elevation, thinned, prior, reach, elevation.cell_m)
    fitting = fitting_of(terrain, thinned, prior, elevation, settings)
    found, weights = _refined(fitting, starts, prior)
    best = int(np.argmax(weights))
    place, about = found[best], np.eye(2) * elevation.sigma_ne_m**2
    if soundings.kind is Kind.PROFILE:
        place, spread = of_neighbours(fitting, place)
        about += spread
    place = settled(fitting, place)
    claimed = place.covariance[:2, :2] + about
    elsewhere = np.array([_apart_m(one, found[best]) > _near_m(fitting) for one in found])
    evidence = _evidence(fitting, place, claimed, float(weights[elsewhere].sum()))
    return _judged(soundings, prior, place, claimed, evidence, settings)


SEARCH_BLUR = 0.4
"""Cells by which a sounding lies off its place in the search: 1/sqrt(12) each for the sounding's cell and for the position's."""


def _reach_m(soundings: Soundings, prior: TerrainPrior) -> Vec2:
    slack = 2 * prior.sigma_drift_mps * float(soundings.age_s.max(initial=0.0))
    north, east = (SIGMAS * math.sqrt(v) + slack for v in np.diag(np.array(prior.cov_ne_m2)))
    return float(north), float(east)


def _window(elevation: ElevationMap, soundings: Soundings, prior: TerrainPrior, reach: Vec2, cell_m: float) -> Terrain:
    """The elevations wherever the soundings may lie."""
    low, high = soundings.points_m[:, :2].min(0), soundings.points_m[:, :2].max(0)
    centre, half = np.array(prior.p_ne_m) + (low + high) / 2, (high - low) / 2 + np.array(reach) + 4 * cell_m
    return elevation.window((float(centre[0]), float(centre[1])), (float(half[0]), float(half[1])), cell_m)


def _searchable(
    thinned: Soundings, prior: TerrainPrior, elevation: ElevationMap, settings: TerrainSettings
) -> tuple[Soundings, tuple[float, list[FloatArray]] | None]:
    """The soundings with their search, or the latest part of them that can be searched: over less time a drift does less."""
    while True:
        planned = _planned(thinned, prior, elevation, _reach_m(thinned, prior), settings)
        late = np.flatnonzero(thinned.age_s <= LATE_SHARE * float(thinned.age_s.max(initial=0.0)))
        if planned is not None or len(late) < FEWEST_LATE or len(late) == len(thinned.age_s):
            return thinned, planned
        thinned = thinned.picked(late)


def _planned(
    soundings: Soundings, prior: TerrainPrior, elevation: ElevationMap, reach: Vec2, settings: TerrainSettings
) -> tuple[float, list[FloatArray]] | None:
    """The search's cell (m) and its hypotheses: the cell grows until both together are no more than `most_work`; None where that
    is not so at the coarsest."""
    cell = max(elevation.cell_m, settings.search_cell_m)
    extent = np.ptp(soundings.points_m[:, :2], axis=0) / 2
    while cell <= max(COARSEST_M, 4 * elevation.cell_m):
        hypotheses = _hypotheses(soundings, prior, cell)
        area = 4 * (reach[0] + extent[0]) * (reach[1] + extent[1]) / cell**2
        if area * len(hypotheses) <= settings.most_work:
            return cell, hypotheses
        cell *= 1.25
    return None


def _hypotheses(soundings: Soundings, prior: TerrainPrior, cell_m: float) -> list[FloatArray]:
    """Headings and drifts (as `Refined.unknowns`) such that one of them leaves less than about a cell of misfit."""
    radius = float(np.percentile(np.hypot(soundings.beams_m[:, 0], soundings.beams_m[:, 1]), 80))
    span = float(np.ptp(soundings.age_s)) / 2
    yaw = _steps(prior.sigma_yaw_rad, cell_m / max(radius, 1.0))
    drift = _steps(prior.sigma_drift_mps, cell_m / max(span, 1e-3))
    return [np.array([0, 0, 0, y, 0, 0, n, e, 0, 0], np.float64) for y, n, e in product(yaw, drift, drift)]


def _steps(sigma: float, step: float) -> FloatArray:
    """Symmetric grid over two sigma of at most twice a step's spacing."""
    n = max(0, math.ceil((2 * sigma - step) / (2 * step)))
    return np.asarray(np.linspace(-2 * sigma, 2 * sigma, 2 * n + 1) if n else np.zeros(1), dtype=np.float64)


def _starts(volume: Volume, terrain: Terrain, prior: TerrainPrior, hypotheses: list[FloatArray]) -> list[FloatArray]:
    """Where to refine: the likeliest places of the posterior under the prior."""
    scores = volume.scores
    rows, cols = scores.score.shape
    v, u = np.mgrid[0:rows, 0:cols]
    cells = np.stack([v + scores.origin_px[1], u + scores.origin_px[0]], -1)
    ne = terrain.first_ne_m + cells * terrain.cell_m
    away = squared_sigmas(ne - np.array(prior.p_ne_m), prior, terrain.cell_m)
    known = scores.score > NO_SCORE
    weighted = scores.score - 0.5 * away
    lifted = np.where(known, weighted - weighted[known].min() + 1 if known.any() else 0, NO_SCORE).astype(np.float32)
    found = posterior(replace(scores, score=lifted), known & (away <= SIGMAS**2 + 1), 1.0)
    starts = []
    for mode in found.modes[:MODES]:
        if mode.mass < LEAST_MASS:
            continue
        row, col = mode.v_px - scores.origin_px[1], mode.u_px - scores.origin_px[0]
        start = hypotheses[mode.hypothesis].copy()
        start[:2] = ne[row, col] - np.array(prior.p_ne_m)
        start[2] = -volume.offset_m[row, col]
        starts.append(start)
    return starts


def _refined(fitting: Fitting, starts: list[FloatArray], prior: TerrainPrior) -> tuple[list[Refined], FloatArray]:
    """The refined places and heights, each once, and their posterior probabilities under the prior.

    Where crowns hide nearly all of the ground, they fit as a rough ground: a place whose height is off the prior's is refined
    from that height, too.
    """
    found: list[Refined] = []
    for start in starts:
        one = fine.refine(fitting, start)
        if _added(found, one, fitting) and abs(one.unknowns[2]) > max(prior.sigma_h_m, fitting.noise.sigma_m):
            at_prior = one.unknowns.copy()
            at_prior[2] = 0.0
            _added(found, fine.refine(fitting, at_prior), fitting)
    return found, weights_of(found, prior)


def _added(found: list[Refined], one: Refined, fitting: Fitting) -> bool:
    """Whether it is another than those found, and was added to them."""

    def differs(other: Refined) -> bool:
        return _apart_m(one, other) > _near_m(fitting) or abs(one.unknowns[2] - other.unknowns[2]) > fitting.noise.sigma_m

    new = all(differs(other) for other in found)
    if new:
        found.append(one)
    return new


def _apart_m(one: Refined, other: Refined) -> float:
    return float(np.hypot(*(one.unknowns[:2] - other.unknowns[:2])))


def _near_m(fitting: Fitting) -> float:
    """Within which two places are one."""
    return SAME_CELLS * fitting.terrain.cell_m


def _evidence(fitting: Fitting, best: Refined, cov: FloatArray, others: float) -> Evidence:
    prior = fitting.prior
    both = np.array(prior.cov_ne_m2) + cov
    away = best.unknowns[:2]
    judged_by = cov - best.covariance[:2, :2] + best.counted_alike_m2
    return Evidence(
        others,
        math.sqrt(float(np.linalg.eigvalsh(judged_by)[-1])),
        best.gain,
        best.reliability,
        best.noise.sigma_m / fitting.noise.sigma_m,
        best.ground,
        fitting.temper * len(fitting.soundings.points_m),
        math.sqrt(float(away @ np.linalg.solve(both, away))),
        abs(float(best.unknowns[2])) / math.hypot(prior.sigma_h_m, math.sqrt(best.covariance[2, 2])),
        best.known,
        float(best.converged),
    )


def _judged(
    of: Soundings, prior: TerrainPrior, best: Refined, cov: FloatArray, evidence: Evidence, settings: TerrainSettings
) -> TerrainFix | NoTerrainFix:
    p = probability_wrong(evidence)
    prior_sigma = largest_sigma_m(prior.cov_ne_m2)
    worst = max(settings.max_sigma_m, settings.sigma_share * prior_sigma)
    claimed_m = math.sqrt(float(np.linalg.eigvalsh(cov)[-1]))
    declined = refusal(evidence, p, claimed_m, of.kind, replace(settings, max_sigma_m=worst))
    numbers = (*evidence.numbers(), ("probability_wrong", p))
    if declined is not None:
        return NoTerrainFix(of.t_ns, *declined, numbers)
    north, east, up = (float(v) for v in best.unknowns[:3])
    (nn, ne), (_, ee) = cov
    mean_m2, walk_m2 = float(best.covariance[2, 2]), prior.sigma_h_walk**2
    return TerrainFix(
        of.t_ns,
        (prior.p_ne_m[0] + north, prior.p_ne_m[1] + east),
        ((float(nn), float(ne)), (float(ne), float(ee))),
        prior.h_amsl_m + up,
        math.sqrt(mean_m2 + walk_m2 * best.walked.now_m2),
        p,
        best.walked.age_s,
        math.sqrt(mean_m2 + walk_m2 * best.walked.then_m2),
        (tuple(best.by_drift[0].tolist()), tuple(best.by_drift[1].tolist())),
        numbers,
    )
