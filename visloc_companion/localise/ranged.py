"""Whether what a rangefinder met may be the surface that the map shows, or what has grown, been felled or been built since."""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.geo.raster import apply_affine, invert_affine
from visloc_companion.localise.odometry.base import Surface
from visloc_companion.localise.terrain.tallest import TALLEST_M
from visloc_companion.types import Beam

SIGMAS = 4.0
LEAST_REACH_M = 3.0


def fits(beam: Beam, up_m: float, sigma_up_m: float, sigma_place_m: float, sigma_tilt_rad: float, surface: Surface) -> bool:
    """Whether a beam of a camera at `up_m` (above the zero of the surface's heights) over the surface's origin ends no more than
    TALLEST_M, and SIGMAS of what altitude and beam may be off, beyond the heights about its end: as far about it as the place and
    the beam's direction leave open. True where the surface is not known there."""
    north, east, down = beam.end_ned_m
    length_m = math.sqrt(north**2 + east**2 + down**2)
    sigma_end_m = math.hypot(sigma_place_m, sigma_tilt_rad * length_m)
    reach_px = max(1, math.ceil(max(LEAST_REACH_M, SIGMAS * sigma_end_m) / surface.pixel_m))
    col, row = (round(float(x)) for x in apply_affine(invert_affine(surface.A_ne_pix), np.array([north, east])))
    rows, cols = (slice(max(0, at - reach_px), max(0, at + reach_px + 1)) for at in (row, col))
    around = surface.up_m[rows, cols]
    around = around[np.isfinite(around)]
    if not around.size:
        return True
    open_m = TALLEST_M + SIGMAS * math.hypot(sigma_up_m, beam.sigma_m, sigma_tilt_rad * math.hypot(north, east))
    return float(around.min()) - open_m <= up_m - down <= float(around.max()) + open_m


def fits_height(beam: Beam, height_m: float, sigma_height_m: float) -> bool:
    """The same where no map says what lies below, only how far below ground lies; True where nothing does (infinity)."""
    open_m = TALLEST_M + SIGMAS * math.hypot(sigma_height_m, beam.sigma_m)
    return not abs(beam.end_ned_m[2] - height_m) > open_m


def is_plane(surface: Surface) -> bool:
    """Whether a surface is the plane that stands for the land where a map has no heights."""
    known = surface.up_m[np.isfinite(surface.up_m)]
    return bool(known.size) and float(known.min()) == float(known.max())
