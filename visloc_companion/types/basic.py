"""Vectors, enumerations and places: what events, commands and values are made of."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

Vec2 = tuple[float, float]
Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]
Cov2 = tuple[Vec2, Vec2]
"""A symmetric 2x2 covariance, row by row, axes north and east."""
FloatArray = NDArray[np.float64]
Image = NDArray[np.uint8]
"""Pixels: (H, W) grey or (H, W, 3) RGB, uint8."""


class AutopilotKind(StrEnum):
    """Which autopilot software answers."""

    ARDUPILOT = "ardupilot"
    PX4 = "px4"
    UNKNOWN = "unknown"


class Verdict(StrEnum):
    """What the GNSS monitor believes of the satellite position."""

    OK = "ok"
    SUSPECT = "suspect"
    DENIED = "denied"


class Mode(StrEnum):
    """The navigator's state (transitions: core/modes.py)."""

    WAITING = "waiting"
    SHADOW = "shadow"
    AIDING = "aiding"
    DEAD_RECKONING = "dead_reckoning"
    LOST = "lost"


class InjectionPolicy(StrEnum):
    """When external positions are sent."""

    NEVER = "never"
    WHEN_UNRELIABLE = "when_unreliable"
    ALWAYS = "always"


class BeyondLimit(StrEnum):
    """What is sent to the autopilot while the protection level exceeds the alert limit."""

    INJECT = "inject"
    WIDEN = "widen"
    STOP = "stop"


class Vote(StrEnum):
    """Which of the two independent localisers is asked: by the map's picture, or by its shape."""

    IMAGE = "image"
    STRUCTURE = "structure"


class Severity(StrEnum):
    """Severity of a Notice, mapped to MAV_SEVERITY when it goes to the operator."""

    INFO = "info"
    NOTICE = "notice"
    WARNING = "warning"
    CRITICAL = "critical"


class EkfSource(StrEnum):
    """Which horizontal position the autopilot is told to use."""

    GNSS = "gnss"
    VISION = "vision"


@dataclass(frozen=True, slots=True)
class Sun:
    """Where the sun stands: azimuth clockwise from true north and elevation, degrees."""

    azimuth_deg: float
    elevation_deg: float


@dataclass(frozen=True, slots=True)
class GeoPoint:
    """A place: WGS 84 latitude and longitude in degrees, height above mean sea level in metres.

    The height is orthometric, as the autopilot reports it; a pack with another vertical datum converts (maps/).
    """

    lat_deg: float
    lon_deg: float
    h_amsl_m: float
