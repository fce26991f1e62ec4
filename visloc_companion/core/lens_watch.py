"""Tells the operator once that the lens is not as it was calibrated: the filter allows for it (propagation.FIX_LENS), but heights
and matches suffer, and a calibration mends it."""

from __future__ import annotations

import math

from visloc_companion.core.belief import Belief
from visloc_companion.core.propagation import FIX_LENS
from visloc_companion.types import Command, Notice, Severity

LEAST_SHARE, SURE_SIGMA = 0.015, 4.0
HELD_NS = 20_000_000_000
"""It has to stay so for so long: an attitude that errs for some seconds looks like another lens while the camera leans."""


class LensWatch:
    """Looks at each belief that a fix has led to."""

    def __init__(self) -> None:
        self._told = False
        self._since_ns: int | None = None

    def after(self, belief: Belief) -> list[Command]:
        """What is to be said now."""
        longer, sigma = float(belief.x[FIX_LENS]), math.sqrt(float(belief.P[FIX_LENS, FIX_LENS]))
        if abs(longer) < max(LEAST_SHARE, SURE_SIGMA * sigma):
            self._since_ns = None
            return []
        self._since_ns = belief.t_ns if self._since_ns is None else self._since_ns
        if self._told or belief.t_ns - self._since_ns < HELD_NS:
            return []
        self._told = True
        text = f"visloc: lens {100 * abs(longer):.1f} % {'longer' if longer > 0 else 'shorter'} than calibrated"
        data = (("longer_share", longer), ("sigma_share", sigma))
        return [Notice(Severity.WARNING, text, to_operator=True, data=data)]
