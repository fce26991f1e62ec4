"""The air's drag on a multicopter: what its accelerometers say of its velocity.

Thrust has no part across the rotors' axis, so along the body's forward and right axes an accelerometer feels drag alone (Martin
& Salaun, "The true role of accelerometer feedback in quadrotor control", 2010; Leishman et al., "Quadrotors and accelerometers",
2014), and no tilt that the autopilot errs by. Along each axis force = -(k1 + k2 |u|) u + bias at a velocity u through the air:
rotors make the linear part, the hull the other, as ArduPilot's EKF3 and PX4's EKF2 have it (EK3_DRAG_MCOEF, EKF2_BCOEF_X).

State (6,): k1 (1/s), k2 (1/m), wind north and east (m/s), bias forward and right (m/s²).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from visloc_companion.types import FloatArray, Vec2, Vec3

WIND, BIAS = slice(2, 4), slice(4, 6)
LEAST_SLOPE_PER_S = 0.05
"""Where the force changes by less than that with the velocity it tells nothing of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Felt:
    """Mean specific force along forward and right (2,), m/s², about a time; those axes in NED (2, 3)."""

    t_boot_ns: int
    force_mps2: FloatArray
    axes_ned: FloatArray


def force_mps2(x: FloatArray, axes_ned: FloatArray, v_ned_mps: Vec3) -> FloatArray:
    """Specific force along the axes (2,) of a vehicle that moves at a velocity."""
    u = _along(x, axes_ned, v_ned_mps)
    return np.asarray(-(x[0] + x[1] * abs(u)) * u + x[BIAS], dtype=np.float64)


def by_velocity(x: FloatArray, axes_ned: FloatArray, v_ned_mps: Vec3) -> FloatArray:
    """Its derivative (2, 2) by the velocity's north and east."""
    u = _along(x, axes_ned, v_ned_mps)
    return np.asarray(-(x[0] + 2 * x[1] * abs(u))[:, None] * axes_ned[:, :2], dtype=np.float64)


def by_state(x: FloatArray, axes_ned: FloatArray, v_ned_mps: Vec3) -> FloatArray:
    """Its derivative (2, 6) by the state."""
    u = _along(x, axes_ned, v_ned_mps)[:, None]
    return np.hstack((-u, -abs(u) * u, -by_velocity(x, axes_ned, v_ned_mps), np.eye(2)))


def velocity_ne_mps(x: FloatArray, felt: Felt, down_mps: float) -> Vec2 | None:
    """The velocity north and east that explains what was felt; None where the force tells none."""
    of_drag = felt.force_mps2 - x[BIAS]
    slope_square = x[0] ** 2 + 4 * x[1] * abs(of_drag)  # the slope at u is k1 + 2 k2 |u|
    if x[0] <= 0 or float(slope_square.min()) < LEAST_SLOPE_PER_S**2:
        return None
    u = -2 * of_drag / (x[0] + np.sqrt(slope_square))
    level = felt.axes_ned[:, :2]
    if abs(np.linalg.det(level)) < 0.25:
        return None
    north, east = (np.linalg.solve(level, u - down_mps * felt.axes_ned[:, 2]) + x[WIND]).tolist()
    return north, east


def _along(x: FloatArray, axes_ned: FloatArray, v_ned_mps: Vec3) -> FloatArray:
    """Velocity through the air along the axes (2,)."""
    air = np.array((v_ned_mps[0] - x[2], v_ned_mps[1] - x[3], v_ned_mps[2]))
    return np.asarray(axes_ned @ air, dtype=np.float64)
