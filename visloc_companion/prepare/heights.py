"""What the heights of a pack look like: a wrong datum, unit or kind of model is seen in numbers, not in pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from visloc_companion.maps.manifest import HeightEntry
from visloc_companion.maps.pack import PackMap
from visloc_companion.types import FloatArray

SURFACE_SIDE, CLOUD_SIDE = 64, 10
"""Places on a side at which the surface, and both surface and cloud, are looked at."""
CLOUD_RADIUS_M, CLOUD_POINTS = 15.0, 400
APART_M = 5.0
"""Cloud and surface model of one place: crowns that differ are seen in the median as less than that, a datum or bare ground as
more (the geoid lies up to 107 m off the ellipsoid)."""

PART_PLACES, ALIKE_M = 5, 1.0
"""So many places where the cloud lies that far off, and nearly all by the same (median deviation): a tile of another datum. Woods
and houses that only one of both has differ by more among themselves."""


def surface_range(pack: PackMap) -> dict[str, float] | None:
    """1st percentile, median and 99th percentile of the surface, metres above sea level; None where the ground is a plane.

    Raises MapError for damaged pixels.
    """
    if pack.manifest.heights.grid is None:
        return None
    heights = np.concatenate([pack.heights_amsl_m(row) for row in pack.spread_map_m(SURFACE_SIDE)])
    known = heights[np.isfinite(heights)]
    if not known.size:
        return None
    low, median, high = (round(float(value), 2) for value in np.percentile(known, [1, 50, 99]))
    return {"low_m": low, "median_m": median, "high_m": high}


def cloud_above_at_places(pack: PackMap) -> list[FloatArray]:
    """How far points of a pack's cloud lie above its surface, metres, at each of the places that are looked at, (N,) each.

    Empty where it lacks one of both. Raises MapError for damaged pixels.
    """
    if pack.cloud is None or pack.manifest.heights.grid is None:
        return []
    return [_above(pack, (float(x), float(y))) for row in pack.spread_map_m(CLOUD_SIDE) for x, y in row]


def cloud_above_surface_m(above: Sequence[FloatArray]) -> float | None:
    """Median of what `cloud_above_at_places` gives; None where there is no such point."""
    known = np.concatenate(above) if above else np.zeros(0)
    return round(float(np.median(known)), 2) if known.size else None


def heights_warnings(above: Sequence[FloatArray]) -> list[str]:
    """What is to be said of a cloud (`cloud_above_at_places`) that lies beside the surface model, everywhere or in a part of the
    map."""
    above_m, where = cloud_above_surface_m(above), ""
    if above_m is not None and abs(above_m) <= APART_M:
        medians = np.array([np.median(each) for each in above if each.size])
        off = medians[np.abs(medians - above_m) > APART_M]
        alike = off.size >= PART_PLACES and float(np.median(np.abs(off - np.median(off)))) < ALIKE_M
        above_m, where = float(np.median(off)) if alike else None, f" on {off.size / medians.size:.0%} of the map"
    if above_m is None:
        return []
    side = "above" if above_m > 0 else "below"
    return [
        f"the cloud lies {abs(above_m):.1f} m {side} the surface model{where}: another vertical datum or unit, or a model of the "
        "bare ground, without crowns and roofs; convert one of them, or build with one of them alone"
    ]


def undulation_warnings(heights: HeightEntry, surface: dict[str, float] | None, ground_h_amsl_m: float | None) -> list[str]:
    """What is to be said of a geoid undulation with which a stated height of the ground (None: none is) lies beside the whole
    surface, and with the other sign within it."""
    undulation_m = heights.geoid_undulation_m
    if undulation_m is None or surface is None or ground_h_amsl_m is None:
        return []
    low_m, high_m, turned_m = surface["low_m"] - APART_M, surface["high_m"] + APART_M, 2 * undulation_m
    if low_m <= ground_h_amsl_m <= high_m or not low_m + turned_m <= ground_h_amsl_m <= high_m + turned_m:
        return []
    return [
        f"--geoid-undulation-m {undulation_m:g} puts the surface {surface['low_m']:.0f} to {surface['high_m']:.0f} m above sea "
        f"level, {-undulation_m:g} puts the ground there that --ground-height-m states, {ground_h_amsl_m:g} m: its sign is "
        "wrong, it counts from the ellipsoid up to the geoid"
    ]


def described_undulation(heights: HeightEntry) -> str:
    """On which side of the ellipsoid the geoid was taken to lie, for people; empty where heights came as above sea level."""
    n_m = heights.geoid_undulation_m
    return "" if n_m is None else f", the geoid {abs(n_m):g} m {'above' if n_m >= 0 else 'below'} the ellipsoid"


def described_range(heights: dict[str, Any] | None) -> str:
    """Heights for people; empty where there are none."""
    return "" if heights is None else f"{heights['low_m']:.0f} to {heights['high_m']:.0f} m above sea level"


def described_plane(heights: HeightEntry) -> str:
    """The plane that is the ground of a pack without a surface, for people."""
    return f"plane at {heights.plane_amsl_m:g} m above sea level"


def _above(pack: PackMap, center_map_m: tuple[float, float]) -> FloatArray:
    points = np.zeros((0, 3)) if pack.cloud is None else pack.cloud.within(center_map_m, CLOUD_RADIUS_M, CLOUD_POINTS)
    if not len(points):
        return np.zeros(0)
    above = points[:, 2] - pack.heights_amsl_m(points[:, :2])
    return above[np.isfinite(above)]
