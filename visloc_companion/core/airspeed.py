"""A velocity through the air tells the wind while the velocity is known, and holds the velocity when nothing else does.

What a pitot tube gets wrong (a scale) acts as a wind along the heading: it is taken for wind on a straight course, and a turn
makes another wind of it. So every change of the velocity through the air adds to the uncertainty of the wind.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from visloc_companion.core.belief import Belief, widened_by
from visloc_companion.core.fusion import taken
from visloc_companion.core.propagation import N_STATES, VELOCITY, WIND, Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import Accepted, FloatArray, Rejected, Vec2

H_AIR: FloatArray = -np.eye(N_STATES)[VELOCITY] - np.eye(N_STATES)[WIND]
"""The velocity through the air less the driving velocity: minus the error of that, minus the wind."""
SIGMA_MPS = 1.0
"""1-sigma of one sample: gusts, sideslip."""
SCALE_SIGMA = 0.05
LEAST_MPS = 8.0
"""Below it a pitot tube measures little, and a vehicle hovers."""
GAS_CONSTANT, SEA_LEVEL_K, SEA_LEVEL_HPA, LAPSE_EXPONENT = 287.053, 288.15, 1013.25, 0.190263


@dataclass(frozen=True, slots=True)
class Airspeed:
    """Velocity through the air, north and east m/s, and how far it is from the sample before."""

    t_ns: int
    v_ne_mps: Vec2
    changed_mps: float


def true_airspeed_mps(static_hpa: float, dynamic_hpa: float) -> float:
    """Of an incompressible flow in the standard atmosphere (ICAO Doc 7488): the autopilot's own temperature is its board's."""
    if static_hpa <= 0 or dynamic_hpa <= 0:
        return 0.0
    kelvin = SEA_LEVEL_K * (static_hpa / SEA_LEVEL_HPA) ** LAPSE_EXPONENT
    return math.sqrt(2 * dynamic_hpa / static_hpa * GAS_CONSTANT * kelvin)


def observed(
    belief: Belief, z: Airspeed, driving_ne_mps: Vec2, settings: NavigatorSettings
) -> tuple[Belief, Accepted | Rejected]:
    """The belief after a sample. Beside a velocity that descends from our own fixes it says nothing."""
    if belief.drive is Drive.FED_BACK:
        return belief, Accepted(0.0)
    more = np.zeros((N_STATES, N_STATES))
    more[WIND, WIND] = (SCALE_SIGMA * z.changed_mps) ** 2 * np.eye(2)
    off = np.array(z.v_ne_mps) - np.array(driving_ne_mps)
    return taken(widened_by(belief, more), off, SIGMA_MPS**2 * np.eye(2), H_AIR, settings.gate_sigma)
