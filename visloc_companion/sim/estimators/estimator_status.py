"""What both simulated estimators take in and tell: measurements and health."""

from __future__ import annotations

from dataclasses import dataclass

from visloc_companion.sim.gnss import GnssSample
from visloc_companion.types import Vec3


@dataclass(frozen=True, slots=True)
class ExternalPosition:
    """VISION_POSITION_ESTIMATE or ODOMETRY as received: local NED metres, variances (cov[0], [6], [11]; NaN where unknown).

    `t_s` is the time of validity that the autopilot made of the message's stamp; `t_rx_s` the arrival.
    """

    t_s: float
    t_rx_s: float
    p_ned_m: Vec3
    var_ned_m2: Vec3
    reset_counter: int


@dataclass(frozen=True, slots=True)
class AuxiliaryPosition:
    """GLOBAL_POSITION_SENSOR as PX4 takes it: local NED metres at the time of arrival, and one 1-sigma for both axes."""

    t_s: float
    p_ned_m: Vec3
    sigma_m: float


@dataclass(frozen=True, slots=True)
class GnssMeasurement:
    """A receiver's sample with its position in the autopilot's local metres."""

    sample: GnssSample
    p_local_m: Vec3


@dataclass(frozen=True, slots=True)
class EstimatorHealth:
    """Health as the status messages state it: `*_ratio` is squared and 1 at the gate; `flags` are the message's own."""

    flags: int
    position_ratio: float
    velocity_ratio: float
    height_ratio: float
    position_ok: bool
    source: str
