"""The places that the exhaustive search leaves open, with the probability of each (posterior.py), in metres."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from visloc_companion.geo.raster import apply_affine
from visloc_companion.localise.ortho_rectify import MapGrid
from visloc_companion.localise.posterior import Mask, posterior
from visloc_companion.localise.search import ScoreVolume
from visloc_companion.types import FloatArray

REPORTED = 4
"""Modes that a fix or refusal reports."""
MODE_RADIUS = 0.08
"""A refined candidate belongs to the modes within this share of the footprint's side."""


class PlaceMode(NamedTuple):
    """A mode of the posterior over positions: metres north and east of the local origin, probability."""

    north_m: float
    east_m: float
    mass: float


def place_modes(volume: ScoreVolume, allowed: Mask, grid: MapGrid, temperature: float) -> list[PlaceMode]:
    """All modes of the search's score volume, by falling mass."""
    modes = posterior(volume, allowed, temperature).modes
    at = apply_affine(grid.A_ne_pix, np.array([[m.u_px, m.v_px] for m in modes], dtype=np.float64).reshape(-1, 2))
    return [PlaceMode(float(n), float(e), m.mass) for (n, e), m in zip(at, modes, strict=True)]


def mass_near(modes: Sequence[PlaceMode], ne_m: FloatArray, radius_m: float) -> float:
    """Probability of the modes within a radius of a place."""
    return min(1.0, sum(m.mass for m in modes if math.hypot(m.north_m - ne_m[0], m.east_m - ne_m[1]) <= radius_m))


def mode_numbers(modes: Sequence[PlaceMode], prior_ne_m: FloatArray) -> dict[str, float]:
    """The first modes as evidence: metres north and east of the prior, and probability."""
    numbers: dict[str, float] = {"modes": float(len(modes))}
    for k, mode in enumerate(modes[:REPORTED], 1):
        numbers[f"mode{k}_north_m"] = mode.north_m - float(prior_ne_m[0])
        numbers[f"mode{k}_east_m"] = mode.east_m - float(prior_ne_m[1])
        numbers[f"mode{k}_probability"] = mode.mass
    return numbers
