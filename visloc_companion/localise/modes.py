"""The places that the exhaustive search leaves open, with the probability of each (posterior.py), in metres.

A refined candidate belongs to the modes that show the same ground. Under a tilt that is not known its nadir may be far from
theirs: the search looks with the prior's tilt, the refinement corrects it.
"""

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
    """A mode of the posterior over positions: metres north and east of the local origin of the nadir and of the ground that the
    camera's axis meets, probability."""

    north_m: float
    east_m: float
    view_north_m: float
    view_east_m: float
    mass: float


def place_modes(volume: ScoreVolume, allowed: Mask, grid: MapGrid, temperature: float, to_view_m: FloatArray) -> list[PlaceMode]:
    """All modes of the search's score volume, by falling mass.

    `to_view_m` (K, 2): from the nadir to the ground that is looked at, metres north and east, for each hypothesis.
    """
    modes = posterior(volume, allowed, temperature).modes
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
