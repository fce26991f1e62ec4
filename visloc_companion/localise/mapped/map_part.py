"""The part of a box that a map reaches: what lies beyond its sides need not be read, and hides no map that is small beside it."""

from __future__ import annotations

import numpy as np

from visloc_companion.localise.local_frame import LocalFrame
from visloc_companion.protocols import EdgedMap, ReferenceMap
from visloc_companion.types import FloatArray

BENT = 0.01
"""Share of the map's size by which its corners may lie elsewhere than the CRS says, linearised at a place some kilometres off."""
WORTH = 0.5
"""A box of which the map has more than this share is read as it is."""


def part_on_map(
    ref: ReferenceMap, frame: LocalFrame, low_ne_m: FloatArray, high_ne_m: FloatArray, margin_m: float = 0.0
) -> tuple[FloatArray, FloatArray] | None:
    """The part (low, high; metres north, east) of a box in which the map's rectangle lies, grown by a margin; None where there
    is none. The box itself where the map does not say where it ends."""
    if not isinstance(ref, EdgedMap):
        return low_ne_m, high_ne_m
    corners = (ref.corners_map_m - frame.origin_map) @ np.linalg.inv(frame.J_map_ne).T
    grown_m = margin_m + BENT * float(np.ptp(corners, axis=0).max())
    low, high = np.maximum(low_ne_m, corners.min(0) - grown_m), np.minimum(high_ne_m, corners.max(0) + grown_m)
    return (low, high) if (low < high).all() else None


def worth_reading(
    ref: ReferenceMap, frame: LocalFrame, low_ne_m: FloatArray, high_ne_m: FloatArray, most_m: float, margin_m: float
) -> tuple[FloatArray, FloatArray]:
    """What is read of a box of which windows of `most_m` a side hold a part: the part that the map has, as near to the box's
    middle as it comes. The box itself where that spares less than WORTH, and where the map has nothing of it."""
    part = part_on_map(ref, frame, low_ne_m, high_ne_m, margin_m)
    if part is None:
        return low_ne_m, high_ne_m
    low, high = part
    sides_m, whole_m = np.minimum(high - low, most_m), np.minimum(high_ne_m - low_ne_m, most_m)
    if float(np.prod(sides_m)) > WORTH * float(np.prod(whole_m)) and float((high_ne_m - low_ne_m).max()) <= most_m:
        return low_ne_m, high_ne_m
    middle = np.clip((low_ne_m + high_ne_m) / 2, low + sides_m / 2, high - sides_m / 2)
    return middle - sides_m / 2, middle + sides_m / 2


def reaches_all(ref: ReferenceMap, frame: LocalFrame, low_ne_m: FloatArray, high_ne_m: FloatArray, most_m: float) -> bool:
    """Whether one window of `most_m` a side holds all that the map has of a box."""
    part = part_on_map(ref, frame, low_ne_m, high_ne_m)
    return part is None or float((part[1] - part[0]).max()) <= most_m
