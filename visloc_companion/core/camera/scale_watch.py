"""Tells once that the camera's own motion is that of GNSS times a factor, while no frame was recognised yet: the focal length or
the height above the map is off by it.

A GNSS that is dragged away moves otherwise than the camera by the same in every direction, so that both are told apart once the
vehicle has flown in several: seen = factor * GNSS + drag, with complex numbers for north and east.
"""

from __future__ import annotations

import cmath
import math

import numpy as np

from visloc_companion.core.filter.motion import Motion
from visloc_companion.types import Command, Notice, Severity, Vec2

LEAST_M, KEPT, FEWEST, LEAST_WAY_M = 1.0, 200, 20, 150.0
"""Of one interval; intervals that are kept and asked for, and the way that they make."""
LEAST_SPREAD = 0.25
"""Variance of the displacements over their mean square: 0 straight ahead, 0.5 where half of the way leads to the side."""
TELL_SHARE, MOST_TURN_RAD = 0.12, math.radians(6.0)
MOST_DRAG, MOST_LEFT, SURE_SIGMAS = 0.08, 0.45, 4.0
"""Of the rms displacement: what is the same in every direction, and the rms of what neither explains (a wrong lens bends every
turn as well); and in how many of its own sigmas the factor must differ from 1."""


class ScaleWatch:
    """`on_motion` takes intervals of both; `wrong`: the operator was told, and the camera's motion is not to be used."""

    def __init__(self) -> None:
        self.wrong = False
        self.clear()

    def clear(self) -> None:
        """A fix was taken: what is off by then is found by others."""
        self._pairs: list[tuple[complex, complex]] = []

    def on_motion(self, seen: Motion, gnss_ne_m: Vec2, height_m: float) -> list[Command]:
        """Take what the camera saw of an interval, what the receiver moved in it, and the height above home."""
        gnss = complex(*gnss_ne_m)
        if self.wrong or abs(gnss) < LEAST_M:
            return []
        self._pairs = [*self._pairs[1 - KEPT :], (gnss, complex(*seen.d_ne_m))]
        moved, saw = np.array(self._pairs).T
        rms = math.sqrt(float(np.mean(np.abs(moved) ** 2)))
        off = moved - moved.mean()
        if len(moved) < FEWEST or float(np.abs(moved).sum()) < LEAST_WAY_M or np.mean(np.abs(off) ** 2) < LEAST_SPREAD * rms**2:
            return []
        factor = complex(np.vdot(off, saw) / np.vdot(off, off))
        drag = complex(saw.mean() - factor * moved.mean())
        left = math.sqrt(float(np.mean(np.abs(saw - factor * moved - drag) ** 2)))
        sigma = left / math.sqrt(float(np.vdot(off, off).real))
        scaled = abs(abs(factor) - 1) >= max(TELL_SHARE, SURE_SIGMAS * sigma) and abs(cmath.phase(factor)) <= MOST_TURN_RAD
        if not scaled or abs(drag) > MOST_DRAG * rms or left > MOST_LEFT * rms:
            return []
        self.wrong = True
        higher_m = (1 - abs(factor)) * height_m
        text = f"visloc: fx_px x {abs(factor):.2f}, or map {abs(higher_m):.0f} m too {'high' if higher_m > 0 else 'low'}?"
        data = (("factor", abs(factor)), ("map_higher_m", higher_m), ("intervals", float(len(moved))))
        return [Notice(Severity.WARNING, text, to_operator=True, data=data)]
