"""A question of the navigator about the ground below its track, answered from a reference map: the worker's part."""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.core.terrain.terrain_aiding import METHOD
from visloc_companion.errors import MapError, OutsideMap, Reason
from visloc_companion.localise.answer import Stopwatch
from visloc_companion.localise.local_frame import LocalFrame, local_frame
from visloc_companion.localise.terrain.base import Kind, NoTerrainFix, Soundings, TerrainFix, TerrainPrior
from visloc_companion.localise.terrain.elevation import ElevationMap, elevation_of
from visloc_companion.localise.terrain.information import expected_sigma_m
from visloc_companion.localise.terrain.match import MIN_KNOWN_REGION, locate
from visloc_companion.localise.terrain.settings import TerrainSettings
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import Fix, FloatArray, GeoPoint, NoFix, TerrainRequest

CELL_M, MOST_CELLS = 10.0, 1500
"""Cells of the elevations that are taken from the map; larger where the window would have more on a side."""
SIGMAS, MARGIN_CELLS = 3.0, 6
HEIGHT_SIGMA_M = 0.5
"""1-sigma of a sounding beside the map's: range, barometer's noise and attitude."""
ENOUGH_M, ENOUGH_SHARE = 5.2, 0.4
"""Ground that promises this 1-sigma, or this share of the prior's, is matched before the stretch is as long as it may be. A
promise does not know the noise yet: fixes may claim more (TerrainSettings.max_sigma_m)."""


def answer_terrain(
    request: TerrainRequest, ref: ReferenceMap, sigma_m: float, max_probability_wrong: float, max_search_radius_m: float
) -> Fix | NoFix:
    """Where the vehicle was at the request's time by the ground below its track, or why the ground does not tell.

    `sigma_m` is the 1-sigma of the map's surface heights. The covariance is without the map's own misplacement, which the
    navigation filter adds once to what it states (`navigator.map_sigma_m`).
    """
    watch = Stopwatch()
    settings = TerrainSettings(sigma_share=ENOUGH_SHARE, max_probability_wrong=max_probability_wrong)
    soundings, prior = _soundings(request), _prior(request, max_search_radius_m)
    if not len(soundings.points_m):
        return _no_fix(request, NoTerrainFix(request.t_ns, Reason.TOO_FEW_FEATURES, "no soundings"), watch)
    try:
        frame = local_frame(request.prior.place, ref)  # OutsideMap where the map's CRS has no coordinates
        elevation = _elevation(ref, frame, soundings, prior, sigma_m)
    except (OutsideMap, MapError) as why:
        return _no_fix(request, NoTerrainFix(request.t_ns, Reason.OUTSIDE_MAP, why.what), watch)
    early = None if request.final else _too_early(soundings, prior, elevation, settings)
    answer = early or locate(soundings, prior, elevation, settings)
    if isinstance(answer, NoTerrainFix):
        return _no_fix(request, answer, watch)
    return _fix(request, answer, frame, ref, watch)


def _soundings(request: TerrainRequest) -> Soundings:
    rows: FloatArray = np.array(request.soundings, dtype=np.float64).reshape(-1, 7)
    beams = rows[:, 4:]
    return Soundings(request.t_ns, rows[:, 1:4] + beams, rows[:, 0], HEIGHT_SIGMA_M, Kind.PROFILE, beams)


def _prior(request: TerrainRequest, max_search_radius_m: float) -> TerrainPrior:
    """About the prior's place; no wider than the search may be."""
    prior = request.prior
    cov = np.array(prior.cov_ne_m2)
    worst = math.sqrt(max(float(np.linalg.eigvalsh(cov)[-1]), 1e-6))
    cov *= min(1.0, max_search_radius_m / SIGMAS / worst) ** 2
    return TerrainPrior(
        (0.0, 0.0),
        ((float(cov[0, 0]), float(cov[0, 1])), (float(cov[1, 0]), float(cov[1, 1]))),
        prior.place.h_amsl_m,
        prior.sigma_h_m,
        prior.sigma_yaw_rad,
        prior.sigma_tilt_rad,
        request.sigma_drift_mps,
        request.sigma_drift_mps2,
        request.sigma_wander_m,
    )


def _elevation(ref: ReferenceMap, frame: LocalFrame, soundings: Soundings, prior: TerrainPrior, sigma_m: float) -> ElevationMap:
    """The map's surface wherever the soundings may lie. Raises OutsideMap."""
    low, high = soundings.points_m[:, :2].min(0), soundings.points_m[:, :2].max(0)
    slack = 2 * prior.sigma_drift_mps * float(soundings.age_s.max())
    reach = SIGMAS * np.sqrt(np.diag(np.array(prior.cov_ne_m2))) + slack
    half = (high - low) / 2 + reach
    cell = max(CELL_M, ref.gsd_m, 2 * float(half.max()) / (MOST_CELLS - 2 * MARGIN_CELLS))
    north, east = (2 * math.ceil(h / cell) + 1 + 2 * MARGIN_CELLS for h in half)
    patch = ref.patch(frame.to_map((low + high) / 2), (east, north), cell, 0.0)
    return elevation_of(patch, frame, sigma_m)


def _too_early(
    soundings: Soundings, prior: TerrainPrior, elevation: ElevationMap, settings: TerrainSettings
) -> NoTerrainFix | None:
    if np.isfinite(elevation.height_amsl_m).mean() < MIN_KNOWN_REGION:
        return NoTerrainFix(soundings.t_ns, Reason.OUTSIDE_MAP, "the map does not cover where the prior looks")
    expected = expected_sigma_m(soundings, prior, elevation, settings)
    known = math.sqrt(max(float(np.linalg.eigvalsh(np.array(prior.cov_ne_m2))[-1]), 0.0))
    if expected <= max(ENOUGH_M, ENOUGH_SHARE * known):
        return None
    return NoTerrainFix(soundings.t_ns, Reason.LOW_TEXTURE, f"not enough yet: the ground promises 1-sigma {expected:.0f} m")


def _fix(request: TerrainRequest, found: TerrainFix, frame: LocalFrame, ref: ReferenceMap, watch: Stopwatch) -> Fix:
    lat, lon = ref.to_geo(*frame.to_map(np.array(found.p_ne_m)))
    return Fix(
        request.t_ns,
        request.t_ns,
        request.request_id,
        0,
        METHOD,
        GeoPoint(lat, lon, found.h_amsl_m),
        request.prior.q_ned_frd,
        found.cov_ne_m2,
        found.sigma_h_m,
        request.prior.sigma_yaw_rad,
        found.probability_wrong,
        watch.elapsed_ms,
        found.evidence,
    )


def _no_fix(request: TerrainRequest, why: NoTerrainFix, watch: Stopwatch) -> NoFix:
    finite = tuple((name, value) for name, value in why.evidence if math.isfinite(value))
    return NoFix(request.t_ns, request.t_ns, request.request_id, 0, METHOD, why.reason, watch.elapsed_ms, why.detail, finite)
