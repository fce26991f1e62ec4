"""What was wrong before take-off: the vehicle is not as the daemon was told. These last for the whole flight."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class MountError:
    """The camera is mounted otherwise than configured, by roll, pitch and yaw (radians) about its own axes."""

    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class FocalError:
    """The lens's focal length is this much longer than calibrated, as a share."""

    share: float


@dataclass(frozen=True, slots=True)
class MapShift:
    """Map and surface model lie so far north and east of the truth."""

    north_m: float
    east_m: float


InstallationFault = MountError | FocalError | MapShift
