"""The map's surface about a camera, read once for as long as it serves."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import OutsideMap
from visloc_companion.localise.local_frame import LocalFrame
from visloc_companion.localise.odometry.base import Surface
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import FloatArray

REACH_HEIGHTS = 1.6
"""Half side of the map's window in heights above the ground: what a camera sees that is tilted by 45 degrees, nearly."""
WINDOW_PX = 200
KEPT_SHARE = 0.4
"""A window serves as long as the camera stays within this share of its half side from its middle, ..."""
OUTGROWN = 1.25
"""... and as long as the height asks for one no larger or smaller than by this factor."""
LEAST_HEIGHT_M = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class _Window:
    """A part of the map's surface (H, W), NaN where unknown, where it lies, half its side in metres, the height at its middle,
    and how far apart the surface model's own samples are."""

    up_m: NDArray[np.float32]
    T_map_pix: FloatArray
    half_m: float
    ground_amsl_m: float
    dsm_gsd_m: float

    def serves(self, frame: LocalFrame, h_amsl_m: float) -> bool:
        """Whether a camera at the origin of a local frame and a height sees this part, and not much less than it."""
        height, width = self.up_m.shape
        middle_ne_m = frame.A_ne_pix(self.T_map_pix) @ np.array([(width - 1) / 2, (height - 1) / 2, 1.0])
        needed = REACH_HEIGHTS * max(LEAST_HEIGHT_M, h_amsl_m - self.ground_amsl_m) / self.half_m
        near = float(np.abs(middle_ne_m).max()) <= KEPT_SHARE * self.half_m
        return near and 1 / OUTGROWN <= needed <= OUTGROWN


class SurfaceWindow:
    """Keeps the window that was read last."""

    def __init__(self) -> None:
        self._window: _Window | None = None

    @property
    def ground_amsl_m(self) -> float:
        """The surface's height at the middle of the window; NaN without one."""
        return math.nan if self._window is None else self._window.ground_amsl_m

    def about(self, h_amsl_m: float, ref: ReferenceMap, frame: LocalFrame) -> Surface | None:
        """The surface about the origin of a local frame, for a camera at a height; None off the map."""
        at = np.array(frame.to_map(np.zeros(2)))
        if self._window is None or not self._window.serves(frame, h_amsl_m):
            try:
                self._window = _window(h_amsl_m, ref, at)
            except OutsideMap:
                self._window = None
        if self._window is None:
            return None
        return Surface(self._window.up_m, frame.A_ne_pix(self._window.T_map_pix), self._window.dsm_gsd_m)


def _window(h_amsl_m: float, ref: ReferenceMap, at_map_m: FloatArray) -> _Window | None:
    """The map about a place, for a camera at a height; None where no height is known there. Raises OutsideMap."""
    centre = (float(at_map_m[0]), float(at_map_m[1]))
    below = ref.patch(centre, (3, 3), ref.gsd_m, 0.0).dsm_amsl_m
    known = below[np.isfinite(below)]
    if not len(known):
        return None
    ground_amsl_m = float(np.median(known))
    half_m = REACH_HEIGHTS * max(LEAST_HEIGHT_M, h_amsl_m - ground_amsl_m)
    gsd_m = max(ref.gsd_m, 2 * half_m / WINDOW_PX)
    side = math.ceil(2 * half_m / gsd_m) + 1
    patch = ref.patch(centre, (side, side), gsd_m, 0.0)
    up_m = np.where(patch.valid & np.isfinite(patch.dsm_amsl_m), patch.dsm_amsl_m, np.nan).astype(np.float32)
    return _Window(up_m, patch.T_map_pix, half_m, ground_amsl_m, patch.dsm_gsd_m)
