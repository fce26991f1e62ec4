"""What the exhaustive search leaves open: its posterior over positions (posterior.py) and the places in it, in metres.

A refined candidate belongs to the modes that show the same ground. Under a tilt that is not known its nadir may be far from
theirs: the search looks with the prior's tilt, the refinement corrects it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from visloc_companion.geo.raster import apply_affine
from visloc_companion.localise.candidates.posterior import Mask, Posterior, posterior
from visloc_companion.localise.ortho_rectify import MapGrid
from visloc_companion.localise.search import ScoreVolume
from visloc_companion.types import FloatArray

REPORTED = 4
"""Modes that a fix or refusal reports."""
MODE_RADIUS = 0.08
"""A refined candidate belongs to the modes within this share of the footprint's side."""


class PlaceMode(NamedTuple):
    """A mode of the posterior over positions: metres north and east of the local origin of the nadir and of the ground that the
    camera's axis meets, probability."""

    north_m: float
    east_m: float
    view_north_m: float
    view_east_m: float
    mass: float


class Searched(NamedTuple):
    """The posterior of a search: `modes` by falling mass; of the nadir's position the mean (2,) in metres north and east of the
    local origin, covariance (2, 2) and entropy (nats, over the search's pixels). No modes: none holds a thousandth, or there is
    no score at all, and NaN moments."""

    modes: list[PlaceMode]
    mean_ne_m: FloatArray
    cov_ne_m2: FloatArray
    entropy: float


def searched(volume: ScoreVolume, allowed: Mask, grid: MapGrid, temperature: float, to_view_m: FloatArray) -> Searched:
    """The posterior of a score volume over the allowed positions (H, W).

    `to_view_m` (K, 2): from the nadir to the ground that is looked at, metres north and east, for each hypothesis.
    """
    found = posterior(volume, allowed, temperature)
    J = grid.A_ne_pix[:, :2]
    mean = apply_affine(grid.A_ne_pix, found.mean_px)
    return Searched(_place_modes(found, grid, to_view_m), mean, J @ found.cov_px2 @ J.T, found.entropy)


def _place_modes(found: Posterior, grid: MapGrid, to_view_m: FloatArray) -> list[PlaceMode]:
    modes = found.modes
    at = apply_affine(grid.A_ne_pix, np.array([[m.u_px, m.v_px] for m in modes], dtype=np.float64).reshape(-1, 2))
    places = np.hstack([at, at + to_view_m[[m.hypothesis for m in modes]]]).tolist()
    return [PlaceMode(n, e, view_n, view_e, m.mass) for (n, e, view_n, view_e), m in zip(places, modes, strict=True)]


def mass_near(modes: Sequence[PlaceMode], view_ne_m: FloatArray, radius_m: float) -> float:
    """Probability of the modes that look at ground within a radius."""
    near = (math.hypot(m.view_north_m - view_ne_m[0], m.view_east_m - view_ne_m[1]) <= radius_m for m in modes)
    return min(1.0, sum(m.mass for m, is_near in zip(modes, near, strict=True) if is_near))


def mode_numbers(modes: Sequence[PlaceMode], prior_ne_m: FloatArray) -> dict[str, float]:
    """The first modes as evidence: metres north and east of the prior, and probability."""
    numbers: dict[str, float] = {"modes": float(len(modes))}
    for k, mode in enumerate(modes[:REPORTED], 1):
        numbers[f"mode{k}_north_m"] = mode.north_m - float(prior_ne_m[0])
        numbers[f"mode{k}_east_m"] = mode.east_m - float(prior_ne_m[1])
        numbers[f"mode{k}_probability"] = mode.mass
    return numbers


def search_numbers(found: Searched, prior_ne_m: FloatArray) -> dict[str, float]:
    """The posterior as evidence: its mean north and east of the prior and their 1-sigma (m), their correlation, its entropy, and
    the first modes. Of a position that is told to a pixel the sigmas are those of a pixel."""
    numbers: dict[str, float] = {}
    if np.isfinite(found.mean_ne_m).all():
        north, east = np.sqrt(np.diag(found.cov_ne_m2)).tolist()
        numbers = {
            "search_north_m": float(found.mean_ne_m[0] - prior_ne_m[0]),
            "search_east_m": float(found.mean_ne_m[1] - prior_ne_m[1]),
            "search_sigma_north_m": north,
            "search_sigma_east_m": east,
            "search_correlation": float(found.cov_ne_m2[0, 1]) / (north * east),
            "search_entropy_nats": found.entropy,
        }
    return numbers | mode_numbers(found.modes, prior_ne_m)
