"""How far a position jumps; apart from core/output.py, since the link needs it before the filter's libraries are imported."""

from __future__ import annotations

import math

from visloc_companion.types import Vec3


def step_m(before_m: Vec3, v_before_mps: Vec3, after_m: Vec3, v_after_mps: Vec3, dt_s: float) -> float:
    """How far a position in NED is, horizontally, from where the mean of two velocities leads from an earlier one."""
    north = after_m[0] - before_m[0] - (v_before_mps[0] + v_after_mps[0]) / 2 * dt_s
    east = after_m[1] - before_m[1] - (v_before_mps[1] + v_after_mps[1]) / 2 * dt_s
    return math.hypot(north, east)
