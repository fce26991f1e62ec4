"""Computes a fix a second time now and then: an accelerator that computes wrong, or a bit that flipped, gives itself away.

The second computation has its own copy of the network's weights, runs on the CPU and with one thread. What both have in common
(the frame, the map's file, the program) is not checked by it; a wrong fix between two checks is not noticed.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from visloc_companion.errors import Reason
from visloc_companion.geo.se3 import R_from_quat
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.localise.answer import refused
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.types import Fix, Image, LocaliseRequest, NoFix

OFF_AFTER = 3
"""So many fixes one after the other that were computed twice and differ switch the localiser off."""
LEAST_M, SHARE = 0.05, 0.2
"""Fixes may differ by this share of the claimed sigma, and by LEAST_M: rounding, and a search that takes another of two ways."""
TURN_RAD = math.radians(0.2)


class CheckedTwice:
    """protocols.Localiser: another one; a second one must confirm its every `every`-th fix, and each after one that differed."""

    def __init__(self, first: Localiser, second: Localiser, every: int) -> None:
        self._first, self._second, self._every = first, second, every
        self._unchecked = 0
        self._differed = 0
        self._off = False

    @property
    def method(self) -> str:
        """Name of the localiser that answers."""
        return self._first.method

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The first one's answer; COMPUTATION_DIFFERS where the second one's is another, SWITCHED_OFF after that was repeated."""
        if self._off:
            return refused(request, self.method, Reason.SWITCHED_OFF, "computations differed repeatedly; start visloc again")
        found = self._first.localise(request, pixels, ref)
        if not isinstance(found, Fix) or found.method != self._second.method:
            return found
        self._unchecked += 1
        if self._unchecked < self._every and not self._differed:
            return found
        self._unchecked = 0
        again = self._second.localise(request, pixels, ref)
        what = difference(found, again)
        if what is None:
            self._differed = 0
            return replace(found, elapsed_ms=found.elapsed_ms + again.elapsed_ms)
        self._differed += 1
        self._off = self._differed >= OFF_AFTER
        reason = Reason.SWITCHED_OFF if self._off else Reason.COMPUTATION_DIFFERS
        return refused(request, self.method, reason, what, found.elapsed_ms + again.elapsed_ms)


def difference(found: Fix, again: Fix | NoFix) -> str | None:
    """In what a second computation of a fix differs by more than rounding does; None where it does not."""
    if isinstance(again, NoFix):
        return f"a fix, and then none: {again.reason}"
    north, east, down = ned_from_geo(again.place, found.place)
    (nn, _), (_, ee) = found.cov_ne_m2
    if not math.hypot(north, east) <= LEAST_M + SHARE * math.sqrt(min(nn, ee)):  # so that a NaN differs
        return f"{math.hypot(north, east):.3g} m apart"
    if not abs(down) <= LEAST_M + SHARE * found.sigma_h_m:
        return f"heights {abs(down):.3g} m apart"
    turn = R_from_quat(found.q_ned_frd).T @ R_from_quat(again.q_ned_frd)
    angle = math.acos(float(np.clip((np.trace(turn) - 1) / 2, -1.0, 1.0)))
    return None if angle <= TURN_RAD else f"attitudes {math.degrees(angle):.3g} degrees apart"
